#!/usr/bin/env bash
# windows.sh FOLDER [NATIVE] - the promises of the command line on Windows, under wine: FOLDER/oceanxl.exe and oceanxl-lab.exe (scripts/cross.sh
# windows-x86-64 FOLDER oceanxl oceanxl-lab); NATIVE (build/oceanxl) gives the bytes that they shall give. As root, for disks that are full.
#
# Debian: wine, wine64, bsdutils (script, the terminal of Ctrl-C).
set -u
programs=$(realpath "$1") native=$(realpath "${2:-build/oceanxl}")
export WINEDEBUG=-all LC_ALL=C.UTF-8 OMP_NUM_THREADS=1
folder=$(mktemp -d) passed=0 failed=0
finish() {
    mountpoint -q "$folder/disk" && umount "$folder/disk"
    rm -rf --one-file-system "$folder"
}
trap finish EXIT
cd "$folder" || exit 1
promise() { # NAME CODE WORDS COMMAND...
    local name=$1 code=$2 words=$3 seen
    shift 3
    "$@" >out.txt 2>err.txt </dev/null
    seen=$?
    if [ $seen = "$code" ] && { [ -z "$words" ] || grep -qF -- "$words" out.txt err.txt; }; then passed=$((passed + 1)) && echo "ok   windows_$name"; else
        failed=$((failed + 1)) && echo "FAIL windows_$name: exit $seen, wanted $code with '$words'; it printed:" && tail -n 20 out.txt err.txt
    fi
}
oceanxl() { wine "$programs/oceanxl.exe" "$@"; }
begins() { for _ in $(seq 300); do [ -d "$1/blocks/000" ] && return; sleep 0.1; done; return 1; } # OUT
same() { cmp "$1" "$2" && [ -s "$1" ]; }
beside() { # COMMAND...: while another process trains into busy/, which is then killed
    local code
    wine "$programs/oceanxl.exe" train survey -o busy --iterations 1000000 --max-time 2m --quiet >/dev/null 2>&1 &
    begins busy && "$@"
    code=$?
    kill -9 $!
    wait $! 2>/dev/null
    return $code
}
interrupted() { # OUT: Ctrl-C, typed in a terminal
    local code
    (begins "$1"; sleep 2; printf '\003'; sleep 5) |
        timeout 120 script -qfec "wine '$programs/oceanxl.exe' train survey -o '$1' --iterations 3000" typed.txt >/dev/null
    code=$?
    [ -s "$1/blocks/000/checkpoint.oxl" ] && return $code
}
"$native" synth -o native --views 10 --size 96x64 --points 800 --quiet >/dev/null && "$native" train native -o wanted --iterations 300 --quiet >/dev/null 2>&1 &&
    "$native" train native -o long --iterations 3000 --quiet >/dev/null 2>&1 || exit 1

promise the_lab_is_run_by_the_program 0 survey oceanxl synth -o survey --views 10 --size 96x64 --points 800 --quiet
promise a_synthetic_survey_has_the_same_bytes 0 '' diff -r survey/images native/images
promise a_synthetic_survey_is_trained 0 scene.ply oceanxl train survey -o out --iterations 300 --quiet
promise scene_ply_has_the_same_bytes_as_here 0 '' same out/scene.ply wanted/scene.ply
promise names_with_umlauts_blanks_and_backslashes 0 survey oceanxl synth -o 'Größe 日本\im Meer' --views 10 --size 96x64 --points 800 --quiet
promise trains_there 0 scene.ply oceanxl train 'Größe 日本\im Meer\' -o 'Äus gabe\ü x' --iterations 20 --quiet
promise replaces_its_files 0 scene.ply oceanxl train 'Größe 日本\im Meer' -o 'Äus gabe\ü x' --iterations 20 --quiet
promise leaves_no_temporary_file 1 '' sh -c 'find . -name "*.tmp" | grep tmp'
promise evaluates_there 0 'mean of 2' oceanxl eval 'Äus gabe\ü x\scene.ply' 'Größe 日本\im Meer'
promise renders_there 0 '2 images' oceanxl render 'Äus gabe\ü x' 'Größe 日本\im Meer' -o 'Bilder\ß'
promise converts_there 0 Gaussians oceanxl convert 'Äus gabe\ü x\scene.ply' 'Äus gabe\ß.spz'
promise a_folder_that_is_not_there_is_said 3 'Größe/nichts: there is no such folder' oceanxl check 'Größe\nichts'
promise a_folder_in_use_is_refused 1 'is in use by process' beside oceanxl train survey -o busy --iterations 10
promise a_killed_run_is_taken_up 0 '' oceanxl train survey -o busy --iterations 300 --restart --quiet
promise ctrl_c_stops_the_run_with_a_checkpoint 130 '' interrupted stopped
promise ctrl_c_then_the_same_command 0 '' oceanxl train survey -o stopped --iterations 3000 --quiet
promise ctrl_c_then_the_same_bytes 0 '' same stopped/scene.ply long/scene.ply
mkdir disk
if mount -t tmpfs -o size=400k none disk 2>/dev/null; then
    promise a_full_disk_is_said 1 'fix: ' oceanxl train survey -o disk/out --iterations 20 --quiet
    promise a_full_disk_keeps_no_part_of_a_file 1 '' sh -c 'find disk -name "*.tmp" | grep tmp'
    rm -rf disk/out && mount -o remount,ro disk
    promise a_folder_to_read_only_is_said 1 'Permission denied' oceanxl train survey -o disk/out --iterations 20 --quiet
else echo 'skip windows_a_full_disk, windows_a_folder_to_read_only: no mount here'; fi
echo "$passed passed, $failed failed"
[ $failed = 0 ]
