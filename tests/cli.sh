#!/bin/sh
# cli.sh PROGRAM - the command line's promises: exit codes, messages, files. Prints one line a promise, then a sum.
set -u
program=$(realpath "${1:-build/oceanxl}")
examples=$(realpath "$(dirname "$0")/../examples")
docs=$(realpath "$(dirname "$0")/../docs")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 130' INT TERM
cd "$folder" || exit 1
passed=0 failed=0

# promise NAME CODE WORDS COMMAND...: the command ends with the code, and what it prints holds the words.
promise() {
    name=$1 code=$2 words=$3
    shift 3
    "$@" >out.txt 2>err.txt </dev/null
    seen=$?
    if [ "$seen" = "$code" ] && { [ -z "$words" ] || grep -qF -- "$words" out.txt err.txt; }; then
        passed=$((passed + 1))
        echo "ok   $name"
    else
        failed=$((failed + 1))
        echo "FAIL $name: exit $seen, expected $code with '$words'; it printed:"
        head -n 20 out.txt err.txt
    fi
}
on_stdout() { "$@" 2>/dev/null; }
on_stderr() { "$@" 2>&1 >/dev/null; }
files() { test "$(find "$2" -name "$3" -size +0 | wc -l)" -eq "$1"; } # COUNT FOLDER PATTERN
ctrl_c() { # COMMAND...: stopped by the signal once it trains
    "$@" &
    while kill -0 $! 2>/dev/null && ! grep -q ETA err.txt; do sleep 0.1; done
    kill -INT $!
    wait $!
}
beside() { # COMMAND...: while another process trains into busy/, which is then killed
    rm -f busy/.lock
    "$program" train survey -o busy --iterations 1000000 --max-time 3m --quiet >/dev/null 2>&1 &
    while kill -0 $! 2>/dev/null && ! { grep -q process busy/.lock && test -e busy/run.json; } 2>/dev/null; do sleep 0.05; done
    "$@"
    code=$?
    kill -9 $!
    wait $! 2>/dev/null
    return $code
}
with_signal() { # "SIGNAL COMMAND": once the run trains, the command is run, then the signal sent
    signal=${1%% *} before=${1#"$signal"}
    shift
    : >signalled.txt # that of an earlier run says ETA before this one has begun, and a background process ignores SIGINT until it catches it
    "$@" 2>signalled.txt &
    while kill -0 $! 2>/dev/null && ! grep -q ETA signalled.txt; do sleep 0.05; done
    $before
    kill -"$signal" $!
    wait $!
    code=$?
    cat signalled.txt >&2
    return $code
}
stopped_early() { # COMMAND...: the signal comes while the points of long/ are read
    mkdir -p long/sparse/0 && cp survey/sparse/0/cameras.txt survey/sparse/0/images.txt long/sparse/0 && ln -sfn ../survey/images long/images
    awk '/^#/ { next } { row[n++] = $0 } END { for (k = 0; k < 400; k++) for (i = 0; i < n; i++) { $0 = row[i]; $1 = 100000 * k + $1; print } }' \
        survey/sparse/0/points3D.txt >long/sparse/0/points3D.txt
    "$@" --quiet &
    while kill -0 $! 2>/dev/null && ! test -s early/.lock; do sleep 0.01; done
    kill -TERM $!
    wait $!
}
behind_the_cameras() { # a second copy of the points, which no camera shows, makes blocks of its own
    mkdir -p behind && cp -r survey/. behind
    awk '/^#/ { next } { print; $1 += 100000; $4 += 50; print }' survey/sparse/0/points3D.txt >behind/sparse/0/points3D.txt
    "$program" train behind -o behind/out --block-points 600 --iterations 40 --quiet && "$program" info behind/out/scene.ply
}
displaced() { # two cameras of thirty are moved
    "$program" synth -o displaced --views 30 --size 128x96 --points 3000 --seed 3 --quiet
    awk 'NF == 10 && /IMG_000(05|13)/ { $6 += 0.25; $7 -= 0.15 } { print }' displaced/sparse/0/images.txt >moved.txt &&
        mv moved.txt displaced/sparse/0/images.txt
    "$program" train displaced -o displaced/out --iterations 500 --sh-degree 1 --quiet 2>flags.txt && cat flags.txt && test "$(grep -c 'check its' flags.txt)" = 2
}
single_image() {
    mkdir -p single/sparse/0 && cp survey/sparse/0/cameras.txt single/sparse/0 && ln -sfn ../survey/images single/images
    { sed -n '/^[0-9]/{p;n;p;q;}' survey/sparse/0/images.txt; } >single/sparse/0/images.txt
    printf '1 0 0 0 9 9 9 1 1 0\n' >single/sparse/0/points3D.txt
    "$program" train single -o single/out --iterations 10
}
one_place() { # the positions of all cameras become 0
    mkdir -p place && cp -r survey/. place
    awk '/^#/ { print; next } NF == 10 && $10 ~ /IMG/ { $6 = $7 = $8 = 0 } { print }' survey/sparse/0/images.txt >place/sparse/0/images.txt
    "$program" check place
}
doubled() { # MODEL MODEL: places and sizes of the second are twice those of the first
    "$program" info "$1" --json >one.txt && "$program" info "$2" --json >two.txt &&
        awk -F '[][, ]+' '/"x"|"scale_0"/ { if (NR == FNR) was[$2] = $3; else n += ($3 / was[$2] - 2) ^ 2 < 1e-6 } END { exit n != 2 }' one.txt two.txt
}
without() { # WORDS COMMAND...: it succeeds without printing WORDS
    words_not=$1
    shift
    "$@" >said.txt 2>&1 && cat said.txt && ! grep -qF -- "$words_not" said.txt
}

escapes() { # a name that would change the terminal's title and clear it
    mkdir -p escapes/sparse/0 && cp survey/sparse/0/cameras.txt survey/sparse/0/points3D.txt escapes/sparse/0 && ln -sfn ../survey/images escapes/images
    awk -v name="$(printf '\033]0;owned\007\033[2J\302\233x.png')" 'NF == 10 && !/^#/ && !done { $10 = name; done = 1 } { print }' survey/sparse/0/images.txt >escapes/sparse/0/images.txt
    "$program" check escapes >said.txt 2>&1 && cat said.txt && ! grep -q "$(printf '\033')" said.txt && ! grep -q "$(printf '\302\233')" said.txt
}
full_disk() { # the model fits below the limit of a file's size, imaging.txt does not
    mkdir -p few && head -c 64 /dev/zero >few/a.splat && { awk 'BEGIN { for (i = 0; i < 4000; i++) print "# a comment of some length" }'; } >few/imaging.txt
    mkdir -p few/to && (ulimit -f 16 && "$program" convert few/a.splat few/to/b.ply)
    code=$?
    test ! -e few/to/imaging.txt && return $code
}

promise help_starts_with_the_purpose 0 "from a COLMAP model" on_stdout "$program" --help
promise help_of_a_command_shows_one_to_copy 0 "oceanxl train survey -o out" on_stdout "$program" train --help
promise version_is_printed 0 "oceanxl $(sed -n 's/^#define OXL_VERSION "\(.*\)"$/\1/p' "$docs/../oceanxl.h")" on_stdout "$program" --version
if [ -c /dev/full ]; then
    promise a_page_that_is_printed_to_a_full_disk_is_an_error 1 "standard output could not be written" on_stderr sh -c "'$program' --man >/dev/full"
fi
promise man_is_the_page_in_docs 0 "" sh -c "'$program' --man | cmp - '$docs/oceanxl.1' || { echo 'fix: make man'; false; }"
promise options_page_is_the_one_in_docs 0 "" sh -c "'$program' --options-page | cmp - '$docs/OPTIONS.md' || { echo 'fix: make man'; false; }"
promise options_page_is_short 0 "" sh -c "test \$('$program' --options-page | wc -w) -le 2500"
promise readme_has_lines_of_140_columns_at_most 0 "" awk 'length($0) > 140 { print FILENAME ":" FNR; exit 1 }' "$docs/../README.md"
promise help_shows_basic_options 0 "" sh -c "'$program' train --help | grep -q -- --iterations && ! '$program' train --help | grep -q -- --lr-scale"
promise help_all_shows_every_option 0 "--lr-scale" on_stdout "$program" train --help all
promise no_iterations_is_refused_for_that_alone 2 "option --iterations: found '0', expected a whole number from 1" on_stderr "$program" train survey -o out --iterations 0
promise man_page_has_no_warning_of_groff 0 "" sh -c "! command -v groff || test -z \"\$('$program' --man | groff -man -ww -Tascii 2>&1 >/dev/null)\""
mkdir -p alone && cp "$program" alone/oceanxl
promise synth_without_the_program_beside_it_says_what_builds_it 1 "alone/oceanxl-lab cannot be run" on_stderr alone/oceanxl synth -o nothing
promise the_program_of_studies_refuses_commands_of_the_other 2 "train is a command of oceanxl, not of oceanxl-lab" on_stderr "$program-lab" train survey -o nothing
promise no_command_is_a_usage_error 2 "a command is expected" on_stderr "$program"
promise unknown_command_offers_the_nearest 2 "did you mean train?" on_stderr "$program" trian survey
promise unknown_option_offers_the_nearest 2 "did you mean --iterations?" on_stderr "$program" train survey -o out --iteration 3
promise option_of_another_command_is_refused 2 "option '--depth' is not known" "$program" train survey -o out --depth
promise options_of_other_programs_are_named_as_they_are_here 2 "fix: use --iterations N" on_stderr "$program" train s -o o -n 300
promise long_options_of_other_programs_are_named_as_they_are_here 2 "fix: use -o FOLDER" on_stderr "$program" train s --output o
promise an_output_folder_with_the_name_of_a_model_is_refused 2 "fix: -o model" on_stderr "$program" train s -o model.ply
promise missing_scene_is_a_usage_error 2 "needs SCENE -o OUT" "$program" train
promise missing_value_is_named 2 "option --max-time takes a value: TIME" "$program" train s -o o --max-time
promise wrong_value_is_shown 2 "found '-3'" "$program" train s -o o --iterations=-3
promise missing_sparse_folder_is_named 3 "--sparse names a file of points, or the folder" on_stderr "$program" check . --sparse nowhere
promise endless_numbers_are_refused 2 "found '1e999'" "$program" render m.ply s -o o --scale 1e999
promise endless_places_are_refused 2 "found '0,1e999,0'" "$program" synth -o o --origin 0,1e999,0
promise wrong_unit_is_refused 2 "found '20q'" "$program" train s -o o --max-time 20q
promise one_argument_too_many_is_refused 2 "one argument too many" "$program" eval a b c
promise no_such_scene_is_bad_input 3 "nowhere" "$program" check nowhere
# Without /proc (a folder that chroot was called with) the program does not know what to call again, and they do as OpenMP likes.
promise waiting_threads_sleep 0 "" \
    sh -c "env -u OMP_WAIT_POLICY OMP_DISPLAY_ENV=true '$program' check nowhere >env.txt 2>&1; ! grep -q WAIT_POLICY env.txt || grep -qi \"WAIT_POLICY *= *'passive\" env.txt"
promise waiting_threads_spin_before_they_sleep 0 "" \
    sh -c "env -u OMP_WAIT_POLICY -u GOMP_SPINCOUNT OMP_DISPLAY_ENV=verbose '$program' check nowhere >env.txt 2>&1; [ ! -e /proc/self/exe ] || ! grep -q GOMP_SPINCOUNT env.txt || grep -q \"GOMP_SPINCOUNT *= *'500'\" env.txt"
promise no_such_model_is_bad_input 3 "nowhere.ply" "$program" info nowhere.ply

# A survey of our own; small, so that a step takes a millisecond.
promise synth_writes_a_survey 0 "" "$program" synth -o survey --views 16 --size 96x64 --points 800 --quiet
first=$(ls survey/images | head -n 1) last=$(ls survey/images | tail -n 1)
promise check_accepts_it 0 "16 in the model, 0 missing" "$program" check survey
promise a_folder_may_have_any_name 0 "16 in the model, 0 missing" sh -c "ln -s survey ./-'a\"b %s
c' && '$program' check -- -'a\"b %s
c'"
promise check_prints_json 0 '"images": 16' on_stdout "$program" check survey --json
promise train_does_the_whole_job 0 "out/scene.ply" on_stdout "$program" train survey -o out --iterations 60
for file in scene.ply metrics.json run.json blocks/000/log.csv; do
    promise "train_leaves_$file" 0 "" test -s out/$file
done
promise metrics_hold_what_is_promised 0 "peak_rss_bytes" \
    sh -c 'for k in psnr ssim structure structure_least gaussians bytes seconds iterations peak_rss_bytes; do grep -q "^  \"$k\": " out/metrics.json || exit 1; done; cat out/metrics.json'
promise metrics_are_json 0 "" sh -c '! command -v python3 || { python3 -m json.tool out/metrics.json && python3 -m json.tool out/run.json; }'
promise renders_show_the_held_out_views 0 "" files 2 out/renders "*.image.png"
promise a_pipe_sees_plain_lines 0 "ETA" sh -c "'$program' train survey -o lines --iterations 60 2>&1 | tr '\\r' '#' | grep -v '#'"
promise threads_beyond_the_processors_are_accepted 0 "" "$program" check survey --threads 100000
promise a_message_has_its_fix_below_it 0 "     fix: " on_stderr sh -c "cp -r survey hurt; for i in hurt/images/*; do : >\$i; break; done; '$program' check hurt"
promise a_preset_does_not_undo_what_stands_before_it 0 '"iterations": 40,' sh -c "'$program' train survey -o order --iterations 40 --preset paper --quiet >said.txt && cat order/run.json"
promise quiet_is_quiet 0 "" sh -c "'$program' train survey -o silent --iterations 20 --quiet 2>said.txt && test -s silent/scene.ply && ! test -s said.txt"
promise report_is_written_by_train 0 "</html>" tail -n 1 out/report.html
promise report_is_rewritten 0 "out/report.html" sh -c "rm out/report.html; '$program' report out; test -s out/report.html && echo out/report.html"
promise report_of_nothing_is_bad_input 3 "holds no run.json" "$program" report survey
promise train_prints_at_most_15_lines_of_prose 0 "" sh -c "'$program' train survey -o prose --iterations 60 --exposure on --lamp auto >prose.txt 2>&1 && test \$(grep -vc it/s prose.txt) -le 15 && ! grep residuals prose.txt"
promise check_counts_photos_with_gps_whose_names_differ_from_the_model_s 0 "gps          16 of 16 photos" sh -c \
    "cp -r survey placed && for i in placed/images/*.png; do printf 'Exif\0\0MM\0*\0\0\0\10\0\1\210\45\0\4\0\0\0\1\0\0\0\32\0\0\0\0\0\5\0\1\0\2\0\0\0\2N\0\0\0\0\2\0\5\0\0\0\1\0\0\0\134\0\3\0\2\0\0\0\2E\0\0\0\0\4\0\5\0\0\0\1\0\0\0\144\0\6\0\5\0\0\0\1\0\0\0\154\0\0\0\0\0\0\0\73\0\0\0\1\0\0\0\12\0\0\0\1\0\0\0\24\0\0\0\1' >>\$i; mv \$i \${i%.png}.PNG; done; '$program' check placed"
promise the_model_for_other_viewers_has_its_own_count 0 "model for other viewers      6/6 " sh -c \
    "'$program' train survey -o counted --exposure on --iterations 40 2>&1 | tr '\\r' '\\n' >counted.txt; grep -q '    40/40 ' counted.txt && cat counted.txt"
promise verbose_prints_each_decision_once 0 "" sh -c "'$program' train survey -o twice --iterations 9 --verbose >twice.txt 2>&1; test \$(grep -c 'exposure ' twice.txt) = 1 && ! grep 'blocks .*cut' twice.txt"
promise info_prints_few_digits 0 "" sh -c "'$program' info out/scene.ply >digits.txt && ! grep '[0-9][.][0-9]\{7\}' digits.txt"
promise verbose_prints_the_evidence 0 "residuals" "$program" train survey -o verbose --iterations 9 --verbose
promise the_second_run_has_nothing_to_do 0 "already holds the finished result" "$program" train survey -o out --iterations 60
promise the_log_has_the_metrics_in_the_words_that_scripts_look_for 0 "" grep -q 'held-out test views: PSNR [0-9.]* dB, SSIM [0-9.]*, structure [-0-9.]*,' out/run.json
promise run_json_has_floats_as_short_as_they_are 0 '"ssim_weight": 0.3,' grep '"ssim_weight"' out/run.json
promise the_report_repeats_the_command 0 "--preset draft --iterations 60" grep "oceanxl train" out/report.html
promise the_report_states_the_heights 0 "" grep -q "Heights differ from the sparse points by 0[.][0-9]* units in the median, [0-9.]* % of the cameras' distance" out/report.html
promise the_report_in_metres_has_all_lengths_so 0 "" sh -c \
    "cp out/report.html in_units.html && '$program' report out --scale 10 >/dev/null && grep -q 'covers [0-9.]* metres on the ground, and the map [0-9.]* square metres.*metres in the median' out/report.html &&
     grep -q 'units on the ground' in_units.html && ! grep -q 'units on the ground' out/report.html && cp in_units.html out/report.html"
promise the_report_s_command_gives_the_figures_of_metrics_json 0 "" sh -c \
    "'$program' train survey -o reduced --iterations 30 --max-side 60 --test-every 4 --quiet >/dev/null && mkdir -p path && ln -sf '$program' path/oceanxl &&
     grep '^oceanxl eval' reduced/report.html >command.txt && PATH=path:\$PATH sh -c \"\$(cat command.txt) --json\" 2>/dev/null | grep '^  \"psnr\": ' >again.txt && grep '^  \"psnr\": ' reduced/metrics.json | cmp - again.txt"
promise a_finished_run_is_not_replaced_by_other_options 2 "  iterations: 60 there, 61 here" on_stderr "$program" train survey -o out --iterations 61
promise a_model_takes_the_place_of_the_points 0 "model" sh -c "'$program' train survey -o from --from out/scene.ply --iterations 5 --quiet && grep -q '\"from\": \"out/scene.ply\"' from/run.json && echo model"
promise the_same_seed_gives_the_same_bytes 0 "" sh -c \
    "for t in 1 3; do '$program' train survey -o same\$t --iterations 60 --threads \$t --quiet >/dev/null || exit 1; done; cmp same1/scene.ply same3/scene.ply"
promise another_seed_gives_other_bytes 1 "differ" sh -c "'$program' train survey -o other --iterations 60 --seed 2 --quiet >/dev/null; cmp same1/scene.ply other/scene.ply"
promise max_time_stops_in_good_order 0 "scene.ply" "$program" train survey -o short --iterations 1000000 --max-time 1s
promise ctrl_c_leaves_a_model 130 "holds the current model" ctrl_c "$program" train survey -o stopped --iterations 20000 --max-time 20s
promise a_second_run_in_a_folder_is_refused 1 "busy is in use by process" beside "$program" train survey -o busy --iterations 60
promise a_second_run_that_starts_anew_is_refused_too 1 "busy is in use by process" beside "$program" train survey -o busy --iterations 60 --restart
for command in "ablate survey -o busy" "tradeoff survey -o busy" "train survey -o busy --block 0"; do
    promise "while_another_trains_is_refused_$(echo $command | tr ' /' '__')" 1 "in use by process" beside "$program" $command
done
promise the_lock_of_a_killed_run_is_taken_over 0 "" "$program" train survey -o busy --iterations 20 --restart
promise a_finished_run_leaves_no_lock 0 "" sh -c '! find . -name .lock | grep .'
promise more_threads_than_processors_are_not_used 0 "processor" on_stderr "$program" check survey --threads 1000
promise openmp_s_number_of_threads_is_limited_too 0 "1000 threads requested" on_stderr env OMP_NUM_THREADS=1000 "$program" check survey
promise blocks_of_one_point_are_refused 2 "more than the 14 training views" on_stderr "$program" train survey -o points --block-points 1
promise a_signal_before_training_stops_the_run 130 "interrupted before anything was trained" on_stderr stopped_early "$program" train long -o early
promise nothing_was_trained_then 1 "" test -e early/blocks
if env --default-signal=HUP true 2>/dev/null; then # the caller may ignore SIGHUP
    promise hangup_saves_as_ctrl_c_does 130 "the state is saved" on_stderr with_signal HUP env --default-signal=HUP "$program" train survey -o hung --iterations 1000000 --max-time 3m
else
    echo "skip hangup_saves_as_ctrl_c_does: env has no --default-signal"
fi
promise nohup_continues 0 "hup/scene.ply" sh -c "nohup '$program' train survey -o hup --iterations 400 --quiet & sleep 0.3; kill -HUP \$!; wait \$!"
promise a_file_size_limit_is_reported_as_a_full_disk 1 "check the disk and its free space" on_stderr sh -c "ulimit -f 8; '$program' train survey -o limited --iterations 20 --quiet"
promise a_folder_of_blocks_that_is_deleted_is_made_again 130 "the state is saved" on_stderr with_signal "INT rm -rf gone/blocks" "$program" train survey -o gone --iterations 1000000 --max-time 3m
promise the_state_is_there_again 0 "" files 1 gone/blocks/000 checkpoint.oxl
promise a_mask_of_another_shape_is_reported_by_train 0 "the mask is stretched" on_stderr sh -c \
    "mkdir -p masked && cp -r survey/. masked && '$program' synth -o square --views 2 --size 50x50 --points 50 --quiet && mkdir masked/masks && cp square/images/IMG_00000.png masked/masks/\$(ls survey/images | head -n 1).png && '$program' train masked -o masked/out --iterations 20"
promise the_report_repeats_it 0 "the mask is stretched" grep stretched masked/out/report.html
promise a_block_that_no_view_shows_keeps_its_gaussians 0 "z           [-4" behind_the_cameras
promise displaced_poses_are_flagged_and_no_others 0 "IMG_00013.png is rendered displaced" displaced
promise a_single_image_is_warned_of_once 0 "a single training view" on_stderr single_image
promise warnings_of_reading_the_survey_come_once 0 "" sh -c "cp survey/sparse/0/points3D.txt single/sparse/0 && '$program' train single -o single/more --iterations 10 2>once.txt; test \$(grep -c 'more cases' once.txt) = 1"
promise fewer_gaussians_than_blocks_are_trained 0 "few2/scene.ply" "$program" train survey -o few2 --max-gaussians 1 --iterations 40 --block-points 300
promise json_is_utf8_whatever_the_survey_is_called 0 "" sh -c "n=\$(printf 'a\377b'); ln -s survey \$n && '$program' train \$n -o utf8 --iterations 5 --quiet && { ! command -v python3 || python3 -m json.tool utf8/run.json; } && ! grep 'No map' utf8/report.html"
promise a_glb_that_is_read_is_told_with_what_helps 3 "neither read nor written" sh -c "printf 'glTF____' >scene.glb && '$program' info scene.glb"
promise cameras_at_one_place_are_warned_of 0 "all cameras are at the same place" one_place
promise a_folder_in_the_place_of_a_model_is_bad_input 3 "name a file, not a folder" "$program" info survey
promise memory_refused_by_ram_is_the_budget_where_a_survey_is_read 4 "--ram allows 0.102 MB: " on_stderr "$program" check survey --ram 100K
promise small_memory_limits_are_printed_in_megabytes 4 "1 MB are too little" on_stderr "$program" train survey -o tiny --ram 1M
promise a_memory_limit_that_a_fix_names_suffices_at_once 0 "" sh -c "for more in '' '--sh-degree 3'; do '$program' train survey -o tiny3 --ram 3M --iterations 5 \$more 2>named.txt; test \$? = 4 || exit 9
    '$program' train survey -o tiny3 --iterations 5 --quiet \$more \$(grep -o -e '--ram [0-9]*M' named.txt | head -n 1) || exit 9; rm -r tiny3; done"
promise lines_of_a_kind_are_few 0 "" sh -c "mkdir odd && cp -r survey/. odd && sed -i '/^[0-9]/s/\$/ 999999 0/' odd/sparse/0/points3D.txt && '$program' check odd 2>odd.txt; test \$(wc -l <odd.txt) -le 8 && grep 'more cases' odd.txt"
promise a_refused_resume_names_the_options 2 "  cooldown: 0.2 there, 0.1 here" on_stderr "$program" train survey -o stopped --cooldown 0.1
promise a_preset_given_again_keeps_the_options_of_the_run 2 "  cooldown: 0.2 there, 0.1 here" sh -c \
    "'$program' train survey -o stopped --preset draft --cooldown 0.1 2>said.txt; code=\$?; cat said.txt; grep -q iterations: said.txt && exit 9; exit \$code"
promise ctrl_c_left_the_model 0 "gaussians" "$program" info stopped/scene.ply
promise info_counts_gaussians 0 '"gaussians": ' on_stdout "$program" info out/scene.ply --json
promise eval_prints_the_mean 0 "mean of 2" on_stdout "$program" eval out/scene.ply survey
promise eval_within_ram_prints_the_same 0 "mean of 2" bash -c "'$program' eval out/scene.ply survey >all.txt && '$program' eval out/scene.ply survey --ram 40K >limited.txt; test \$? = 4 && '$program' eval out/scene.ply survey --ram 24M | cmp - all.txt && cat all.txt"
promise ram_is_a_limit_of_memory_also_for_eval 4 "fix: --ram 64M" on_stderr "$program" eval out/scene.ply survey --ram 40K
promise check_says_how_many_blocks_and_why 0 "blocks       1; one block takes about" on_stdout "$program" check survey
promise eval_prints_json 0 '  "psnr": ' on_stdout "$program" eval out/scene.ply survey --json
promise a_model_is_placed_by_its_origin 0 "" sh -c \
    "LC_ALL=C sed '1,/^end_header/s/^comment origin.*/comment origin 1e6 0 0/' out/scene.ply >moved.ply; for m in out/scene moved; do '$program' eval \$m.ply survey >\$(basename \$m).txt || exit 1; done; ! cmp -s scene.txt moved.txt"
promise render_draws_every_view 0 "16 images in all" "$program" render out/scene.ply survey -o all --split all --depth
promise render_writes_depth 0 "" files 16 all "*.depth.pfm"
promise render_writes_a_map 0 "in the world's x and y" on_stdout "$program" render out/scene.ply survey -o ortho --ortho --pixel 0.05
promise map_has_its_heights 0 "" sh -c 'test -s ortho/ortho.tif && test -s ortho/height.tif'
promise map_replaces_its_own_and_no_other_programs 2 "mine/height.tif exists, and OceanXL did not write it" sh -c \
    "'$program' render out/scene.ply survey -o ortho --ortho --pixel 0.05 && mkdir -p mine && echo dem >mine/height.tif &&
     '$program' render out/scene.ply survey -o mine --ortho; code=\$?; grep -qx dem mine/height.tif && exit \$code"
promise convert_again_is_no_fault 0 "Gaussians in metric2.ply" sh -c "'$program' convert out/scene.ply metric2.ply && '$program' convert out/scene.ply metric2.ply --scale 2"
promise convert_replaces_models_and_nothing_else 2 "points.ply exists, but is not a readable model" sh -c \
    "echo cloud >points.ply; '$program' convert out/scene.ply points.ply; code=\$?; grep -qx cloud points.ply && ! ls points.ply.* 2>/dev/null && exit \$code"
promise train_replaces_no_report_of_another_program 2 "mine3/report.html exists" sh -c "mkdir -p mine3 && echo mine >mine3/report.html && '$program' train survey -o mine3"
promise report_replaces_no_page_of_another_program 2 "mine4/report.html exists" sh -c \
    "mkdir -p mine4 && cp out/run.json mine4 && echo mine >mine4/report.html && '$program' report mine4"
promise a_study_replaces_no_table_of_another_program 2 "mine3/ablate.csv exists" sh -c \
    "echo mine >mine3/ablate.csv && '$program' ablate survey -o mine3 --rows v1 --iterations 10 --seeds 1"
promise cloud_writes_points 0 "cloud.las, " "$program" cloud out/scene.ply survey -o cloud.las
promise cloud_writes_triangles 0 "mesh.obj, " "$program" cloud out/scene.ply survey -o mesh.obj --mesh
promise compare_finds_nothing_between_a_run_and_itself 0 "at 0 places" "$program" compare out out -o change
promise compare_wants_a_polygon_of_three_corners 2 "three corners or more" on_stderr "$program" compare out out -o change --polygon "0,0;1,1"
promise eval_takes_the_sides_of_training 0 "--max-side 48, as in training" on_stderr sh -c "'$program' train survey -o sides --max-side 48 --iterations 5 --quiet >/dev/null && '$program' eval sides/scene.ply survey"
promise cloud_refuses_a_file_of_another_program_in_any_folder 2 "OceanXL did not write it" on_stderr sh -c "echo mine >\"\$PWD/mine.las\"; '$program' cloud out/scene.ply survey -o \"\$PWD/mine.las\""
promise cloud_says_which_files_it_writes 2 "expected a file *.ply or *.las" on_stderr "$program" cloud out/scene.ply survey -o cloud.xyz
promise map_says_its_axes 0 "1 0 0 0" cat ortho/frame.txt
promise map_of_own_axes_refuses_an_epsg_code 2 "--frame world if the survey is georeferenced" on_stderr "$program" render out/scene.ply survey -o ortho --ortho --frame survey --epsg 32632
promise options_of_a_map_want_a_map 2 "--epsg applies to --ortho only" "$program" render out/scene.ply survey -o ortho --epsg 32632
promise render_follows_a_path 0 "3 images in flight" "$program" render out/scene.ply survey -o flight --flight survey --frames 3
promise a_shorter_flight_removes_old_frames 0 "" sh -c "'$program' render out/scene.ply survey -o flight --flight survey --frames 5 && '$program' render out/scene.ply survey -o flight --flight survey --frames 3"
promise a_flight_keeps_its_frames 0 "" files 3 flight "frame_*.png"
promise render_refuses_another_path 2 "orbit|survey" "$program" render out/scene.ply survey -o flight --flight home
promise a_closed_pipe_does_not_end_the_run 0 "" sh -c "'$program' train survey -o heard --iterations 30 2>&1 | head -n 1; test -s heard/scene.ply"
promise render_refuses_two_kinds_of_images 2 "use one of the two" "$program" render out/scene.ply survey -o flight --flight orbit --ortho
promise measure_wants_pixels_of_the_image 3 "lies outside of its" "$program" measure survey --scale-bar IMG_00000.png,5000,9000,IMG_00001.png,5,9:0,0,0
promise measure_refuses_rays_that_miss 3 "miss each other by" on_stderr "$program" measure survey --scale-bar $first,10,50,$last,90,5:0,0,0 --length 1
promise measure_refuses_a_bar_without_length 3 "both ends are at the same place" on_stderr "$program" measure survey --scale-bar 1,2,3:1,2,3 --length 1
promise measure_prints_a_distance 0 "scale     0.5 metres per unit" "$program" measure survey --scale-bar 0,0,0:2,0,0 --length 1
promise measure_wants_a_bar 2 "--scale-bar" "$program" measure survey
promise missing_vulkan_is_reported 1 "fix: " env OXL_VULKAN_LIBRARY=none "$program" eval out/scene.ply survey --backend vulkan
promise listing_without_vulkan_is_reported 1 "Vulkan" env OXL_VULKAN_LIBRARY=none "$program" info --devices
promise backend_auto_falls_back_to_the_cpu 0 "mean of 2" env OXL_VULKAN_LIBRARY=none "$program" eval out/scene.ply survey --backend auto
promise another_backend_is_refused 2 "cpu|auto|vulkan" "$program" eval out/scene.ply survey --backend cuda
promise a_dry_run_predicts_and_writes_nothing 0 "prediction" sh -c "'$program' train survey -o dry --iterations 30 --dry-run && test ! -e dry"
promise what_no_step_has_told_is_not_printed 0 "" sh -c "'$program' train survey -o staged --iterations 60 --blocks 2 2>&1 | tr '\\r' '\\n' >staged.txt && grep -q 'block 0/' staged.txt && ! grep -q 'loss 0.0000\|  0.0 it/s' staged.txt"
promise a_dry_run_refuses_what_the_run_would 3 "fix: " "$program" train nowhere -o dry --dry-run
promise progress_json_is_lines_of_json 0 "" sh -c "'$program' train survey -o lines --iterations 30 --restart --progress json 2>lines.txt >/dev/null && grep -q '^{\"event\": \"progress\", .*\"iteration\": 30, ' lines.txt && ! grep -qv '^{.*}\$' lines.txt"
promise progress_json_holds_errors_too 3 '{"event": "log", "level": "error"' on_stderr "$program" train nowhere -o lines2 --progress json
promise convert_scales 0 "Gaussians in metric.ply" "$program" convert out/scene.ply metric.ply --scale 2
promise convert_scales_places_and_sizes 0 "" doubled out/scene.ply metric.ply
promise convert_keeps_the_scale_for_info 0 '"scale": 2' on_stdout "$program" info metric.ply --json
promise a_scaled_model_is_compared_in_the_survey_s_unit 0 "" sh -c \
    "'$program' convert out/scene.ply plain.ply && for m in plain metric; do '$program' eval \$m.ply survey 2>warned.txt | awk '/mean of 2/ { print \$1 }' >\$(basename \$m).txt; done; ! grep . warned.txt &&
     '$program' convert metric.ply metric.spz && '$program' convert metric.spz again.ply && LC_ALL=C grep -a -c '^comment scale 2' again.ply &&
     awk 'NR == FNR { was = \$1; next } { exit (\$1 - was) ^ 2 > 1e-4 }' plain.txt metric.txt && rm -f imaging.txt"
promise a_model_of_another_scale_is_warned_of 0 "does not seem to cover the survey" on_stderr sh -c \
    "LC_ALL=C sed '1,/^end_header/{/^comment scale/d;}' metric.ply >unmarked.ply && ! cmp -s metric.ply unmarked.ply && '$program' eval unmarked.ply survey"
promise a_model_of_another_position_is_warned_of 0 "does not seem to cover the survey" on_stderr "$program" render moved.ply survey -o moved
promise eval_of_the_folder_and_of_scene_ply_agree_with_metrics_json 0 "" sh -c \
    "'$program' train survey -o lit --iterations 60 --lamp on --medium on --quiet >/dev/null && grep '^  \"psnr\": ' lit/metrics.json >lit.txt &&
     for m in lit lit/scene.ply; do '$program' eval \$m survey --json 2>/dev/null | grep '^  \"psnr\": ' | cmp - lit.txt || exit 1; done"
mkdir -p quoted && cp out/scene.ply quoted/ && printf '%s\n' 'lamp 1 a"b\c.png' >quoted/imaging.txt
promise info_escapes_names_of_imaging_txt 0 '"imaging": ["lamp 1 a\"b\\c.png"]' on_stdout "$program" info quoted/scene.ply --json
promise info_lists_what_imaging_txt_has 0 "Binf " on_stdout "$program" info lit/scene_clear.ply
promise convert_on_a_full_disk_fails_and_leaves_no_part_of_imaging 1 "few/to/imaging.txt cannot be written" full_disk
promise control_characters_of_names_are_shown_as_numbers 0 'x1b]0;owned\x07' escapes
promise resume_line_can_be_copied_whatever_the_names_are 130 "oceanxl train 'a b;touch x' -o 'o'\\''o'" \
    ctrl_c sh -c "ln -sfn survey 'a b;touch x'; exec '$program' train 'a b;touch x' -o \"o'o\" --iterations 300000"
promise viewer_reads_and_sorts_what_a_page_must_not_hang_on 0 "" sh -c "! command -v node || node '$examples/../tests/viewer_parts.js'"
promise convert_refuses_a_place_where_the_medium_is_applied_twice 2 "fix: choose another folder" on_stderr "$program" convert lit/scene.ply lit/other.ply
promise convert_refuses_a_name_that_loses_the_medium 2 "fix: choose another name" on_stderr "$program" convert lit/scene_clear.ply lost/scene.ply
promise convert_keeps_what_the_model_is_rendered_with 0 "" sh -c \
    "test ! -e lit/other.ply && mkdir -p fit && '$program' convert lit/scene.ply lit/scene.spz && '$program' convert lit/scene_clear.ply lit/more.ply && '$program' convert lit/scene_clear.ply fit/more.ply &&
     rm lit/scene.spz && for m in lit/more.ply fit/more.ply; do '$program' eval \$m survey --json 2>/dev/null | grep '^  \"psnr\": ' | cmp - lit.txt || exit 1; done; rm lit/more.ply"
promise what_other_viewers_show_of_gains_alone_is_said 0 'without imaging.txt: PSNR' sh -c \
    "'$program' train survey -o gained --exposure on --lamp off --medium off --iterations 40 --quiet && grep -o 'scene.ply without imaging.txt: PSNR' gained/run.json"
promise convert_says_that_gains_are_another_models 0 "belongs to another model" on_stderr sh -c "mkdir -p shown && echo '# x' >shown/imaging.txt && '$program' convert lit/scene_clear.ply shown/b.ply"
promise convert_to_splat_warns_of_the_origin 0 ", the origin" on_stderr "$program" convert out/scene.ply scene.splat
promise convert_writes_splat 0 "scene.splat" "$program" convert out/scene.ply scene.splat
promise convert_reads_it_back 0 "Gaussians in back.ply" "$program" convert scene.splat back.ply
promise check_counts_the_blocks_with_the_options_of_train 0 "blocks       4, as set" "$program" check survey --block-points 250 --seed 3 --exposure off
promise help_all_lists_what_stands_in_place_of_a_command 0 "--options-page" on_stdout "$program" --help all
promise help_breaks_the_line_after_a_long_option 0 "" sh -c "'$program' synth --help all | grep -qF -x '  --water none|I|IA|IB|II|III|1C|3C|5C|7C|9C'"
promise partition_none_is_one_block 0 "blocks       1, as set" "$program" check survey --block-points 9 --partition none
promise ablate_compares_rows 0 "V1 +BSP against 3DGS, midpoint" on_stdout "$program" ablate survey -o ablation --rows 3dgs,v1 --iterations 20 --block-points 250 --threads 1 --quiet
promise ablate_keeps_each_run 0 "ablation,survey,v1,1," sh -c 'test -s ablation/survey/3dgs-seed1/scene.ply && test -s ablation/survey/v1-seed1/scene.ply && test -s ablation/ablate.md && cat ablation/ablate.csv'
promise ablate_counts_the_memory_of_each_training 0 "" awk -F, 'NR > 1 { n++; if (!($14 > 1e6 && $14 < 1e9)) exit 1 } END { exit n != 2 }' ablation/ablate.csv
promise ablate_does_not_train_again 0 "V1 +BSP" without ETA "$program" ablate survey -o ablation --rows 3dgs,v1 --iterations 20 --block-points 250 --threads 1
promise ablate_makes_controls_equal 0 "V3, bytes of OceanXL" on_stdout "$program" ablate survey -o controls --rows v2,v1-count,oceanxl,v3-bytes --iterations 20 --threads 1 --quiet
promise ablate_sets_what_rows_differ_by 2 "each row of ablate sets it itself" "$program" ablate survey -o ablation --ucd on
promise tradeoff_states_the_cost 0 "half the iterations against base" on_stdout "$program" tradeoff survey -o tradeoff --rows iterations-half,coarse-0.5,paper --iterations 20 --max-side 100 --budget 30s --threads 1 --quiet
promise tradeoff_leaves_page_table_and_runs 0 "coarse-0.5,1," sh -c 'test -s tradeoff/tradeoff.md && test -s tradeoff/survey/base-seed1/scene.ply && cat tradeoff/tradeoff.csv'
promise results_of_two_surveys_leave_a_page_and_a_table 0 "| cut survey | base" sh -c "ln -sfn survey 'cut survey' && '$program' results survey 'cut survey' -o results --iterations 8 --max-side 40 --budget 40s --threads 1 --quiet >/dev/null && test -s results/results.csv && cat results/results.md"
promise results_of_a_smaller_budget_keep_what_is_trained_and_train_no_first_row 0 "" sh -c \
    "cp results/results.csv rows.csv && mv results/survey/usual-seed1 gone && '$program' results survey 'cut survey' -o results --iterations 8 --max-side 40 --budget 0.001s --threads 1 >kept.txt 2>&1 && ! grep -q ETA kept.txt && grep -v ',survey,usual,' rows.csv | cmp - results/results.csv"
promise tradeoff_resumes 0 "half the iterations against base" without ETA "$program" tradeoff survey -o tradeoff --rows iterations-half,coarse-0.5 --iterations 20 --max-side 100 --budget 30s --threads 1
promise blocks_side_by_side_give_the_bytes_of_one_process 0 "" sh -c \
    "OCEANXL='$program' '$examples/cluster/local.sh' survey spread --block-points 250 --iterations 40 --seed 5 --keep 1 &&
     '$program' train survey -o alone --block-points 250 --iterations 40 --seed 5 --keep 1 && cmp spread/scene.ply alone/scene.ply"
promise run_json_has_the_decisions_of_the_coarse_and_the_merged_model 0 "" sh -c 'grep -q "\"coarse\": {\"" alone/run.json && grep -q "\"merged\": {\"" alone/run.json'
promise a_finished_run_in_blocks_reports_no_unfinished_block 1 "0" grep -c "not finished" alone/report.html
promise a_render_leaves_nothing_of_an_earlier_one 0 "" sh -c "rm -rf again && '$program' render out/scene.ply survey -o again --split all --depth && touch again/mine.png && '$program' render out/scene.ply survey -o again && test \$(ls again | wc -l) = 3"
promise too_few_open_files_are_told_with_what_helps 1 "fix: allow more open files" sh -c "ulimit -n 4; '$program' train survey -o few --iterations 10"
promise a_study_of_no_seeds_is_refused 2 "1 to 99" "$program" ablate survey -o ablation --seeds 0
promise wrong_rows_are_told_with_what_helps 2 "fix: --rows" "$program" ablate survey -o ablation --rows nope
promise an_unwritable_place_is_a_failure 1 "oxl: " "$program" convert out/scene.ply /dev/null/scene.ply

promise synth_cuts_out_what_is_near_the_centre 0 "composited over --background, by default white" sh -c \
    "'$program' synth -o object --path orbit --views 12 --size 64x48 --points 300 --alpha 1.5 --quiet && '$program' train object -o object/out --iterations 60"
promise a_background_goes_from_the_model_into_evaluation_and_renders 0 "" sh -c \
    "grep -qa '^comment background 1 1 1$' object/out/scene.ply && grep '^  \"psnr\": ' object/out/metrics.json >object/psnr &&
     '$program' eval object/out object --json 2>/dev/null | grep '^  \"psnr\": ' | cmp - object/psnr &&
     '$program' convert object/out/scene.ply object/a.spz >/dev/null && '$program' convert object/a.spz object/a.ply >/dev/null && grep -qa '^comment background 1 1 1$' object/a.ply &&
     '$program' render object/out object -o object/again --split test && for f in object/again/*.png; do cmp \"\$f\" object/out/renders/\"\$(basename \"\$f\")\" || exit 1; done &&
     '$program' render object/out object -o object/black --background 0,0,0 && ! cmp -s object/black/IMG_00000.png.png object/again/IMG_00000.png.png"
promise a_background_is_that_of_every_block 0 "" sh -c \
    "'$program' train object -o object/cut --iterations 60 --blocks 2 --background 0,0.5,1 --quiet >/dev/null && grep -qa '^comment background 0 0.5019608[0-9]* 1$' object/cut/scene.ply"
promise an_object_in_front_of_a_background_covers_its_survey 0 "PSNR" sh -c \
    "'$program' synth -o small --path orbit --views 12 --size 64x48 --points 300 --alpha 0.7 --quiet && '$program' train small -o small/out --iterations 60 --quiet >/dev/null &&
     '$program' eval small/out/scene.ply small 2>&1 | tee small/said && ! grep 'cover the survey' small/said"
mkdir -p object/split && cp -r object/images object/sparse object/split/
promise a_mask_of_alpha_has_no_background 0 "pixels of 12 images are masked" sh -c \
    "'$program' train object/split -o object/masked --iterations 60 --alpha mask 2>&1 && ! grep -qa '^comment background' object/masked/scene.ply"

# Two images of a pool, whose distance PyTorch gives as 0.237096.
if [ -f "${OXL_SHARED:-none}/lpips/alex.bin" ] && /usr/bin/python3 -c 'import numpy, PIL' 2>/dev/null; then
    pool=$OXL_SHARED/data/subvo_pool/images
    promise lpips_of_two_images_is_that_of_pytorch 0 "0.23710  mean of 1, LPIPS" sh -c \
        "cp $pool/f090.jpg a.image.png && cp $pool/f094.jpg a.png && /usr/bin/python3 '$examples/lpips.py' '$OXL_SHARED/lpips/alex.bin' a.image.png"
    promise damaged_lpips_weights_are_refused 1 "examples/lpips_weights.py" /usr/bin/python3 "$examples/lpips.py" "$docs/OPTIONS.md" a.image.png
fi

echo "command line: $passed passed, $failed failed"
[ "$failed" = 0 ]
