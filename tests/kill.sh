#!/bin/sh
# kill.sh PROGRAM [N] - a run that is killed N times (20), at random moments, ends in the bytes of a run that nothing disturbed;
# a full disk and a damaged checkpoint are survived. Prints one line a promise, then a sum.
set -u
program=$(realpath "${1:-build/oceanxl}")
kills=${2:-20}
folder=$(mktemp -d)
trap 'umount "$folder/small" 2>/dev/null; rm -rf "$folder"' EXIT
trap 'exit 130' INT TERM
cd "$folder" || exit 1
passed=0 failed=0

promise() { # NAME COMMAND...
    name=$1
    shift
    if "$@" >out.txt 2>&1 </dev/null; then
        passed=$((passed + 1))
        echo "ok   $name"
    else
        failed=$((failed + 1))
        echo "FAIL $name:"
        tail -n 20 out.txt
    fi
}

iterations=1500
train() { # OUT [option...]
    out=$1
    shift
    "$program" train survey -o "$out" --iterations $iterations --threads 1 --quiet "$@"
}

"$program" synth -o survey --views 12 --size 96x64 --points 1200 --quiet >/dev/null || exit 1
promise an_undisturbed_run_ends train reference
promise in_blocks_too train calm_blocks --block-points 500

# kill_often OUT [option...]: after a time that no clock of the program's knows; the last start is left to end by itself.
kill_often() {
    seed=$(printf '%s' "$1" | cksum | cut -d' ' -f1)
    for i in $(seq "$kills"); do
        seed=$(((seed * 1103515245 + 12345) % 2147483648))
        wait_ms=$((20 + seed / 65536 % 400))
        "$program" train survey -o "$@" --iterations $iterations --threads 1 --quiet >/dev/null 2>&1 & # no function: its shell would be killed instead
        pid=$!
        sleep "$(printf '%d.%03d' $((wait_ms / 1000)) $((wait_ms % 1000)))"
        kill -9 "$pid" 2>/dev/null && echo "killed after $wait_ms ms" || echo "was done"
        wait "$pid" 2>/dev/null
    done
    train "$@"
}
same() { cmp "$1/scene.ply" "$2/scene.ply"; }
promise "a_run_survives_${kills}_kills" kill_often killed
promise it_gives_the_same_bytes same reference killed
promise "a_run_in_blocks_survives_${kills}_kills" kill_often killed_blocks --block-points 500
promise it_gives_the_same_bytes_in_blocks same calm_blocks killed_blocks
promise nothing_is_left_of_files_half_written sh -c '! find killed killed_blocks -name "*.tmp" | grep .'

# stop_at FILE OUT: Ctrl-C as soon as the run has written OUT/blocks/000/FILE, however fast the machine is.
stop_at() {
    "$program" train survey -o "$2" --iterations $iterations --threads 1 2>message.txt &
    pid=$!
    for i in $(seq 6000); do
        [ -s "$2/blocks/000/$1" ] && break
        sleep 0.01
    done
    kill -INT "$pid"
    wait "$pid"
    [ $? = 130 ]
}
interrupt() {
    stop_at checkpoint.oxl "$1" && grep "resume: oceanxl train survey -o $1" message.txt && "$program" train survey -o "$1" --quiet
}
promise ctrl_c_says_how_to_go_on_and_that_command_does interrupt stopped
promise after_ctrl_c_the_bytes_are_the_same same reference stopped
limited() {
    for i in 1 2 3 4 5 6 7 8 9 10 11 12; do train "$1" --max-time 1s; done
}
promise max_time_again_and_again_comes_to_an_end limited limited
promise it_too_gives_the_same_bytes same reference limited

damage() { # the checkpoint loses its end: the run starts again
    stop_at checkpoint.oxl "$1" || return 1
    checkpoint=$1/blocks/000/checkpoint.oxl
    head -c 5000 "$checkpoint" >cut && cp cut "$checkpoint"
    "$program" train survey -o "$1" 2>&1 | grep "is damaged (wrong checksum)"
}
promise a_damaged_checkpoint_is_noticed damage damaged
promise and_the_bytes_are_the_same same reference damaged

full_disk() {
    mkdir small && mount -t tmpfs -o size=700k tmpfs small || return 1
    "$program" train survey -o small/out --iterations $iterations --threads 1 --quiet >message.txt 2>&1
    code=$?
    cat message.txt
    [ $code = 1 ] && grep -q "cannot write" message.txt || return 1
    umount small
}
if [ "$(id -u)" = 0 ] && mkdir -p probe && mount -t tmpfs -o size=100k tmpfs probe 2>/dev/null; then
    umount probe
    promise a_full_disk_ends_in_a_clear_error full_disk
else
    echo "skip a_full_disk_ends_in_a_clear_error: no tmpfs can be mounted here"
fi

echo "kill: $passed passed, $failed failed"
[ "$failed" = 0 ]
