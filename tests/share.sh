#!/bin/sh
# share.sh - runs a test program in as many processes as there are processors, which share its tests, and adds up their sums:
# tests/share.sh PROGRAM [WORD...]. A test is too short for threads to pay, so N processes take little more than an N-th of
# the time. Files lie in memory where Linux has room for them, 32 MB a process: a job waits for the disk after each file.
set -eu
count=$(nproc 2>/dev/null || echo 2)
room=$(df -Pk /dev/shm 2>/dev/null | awk 'NR == 2 { print $4 }')
if [ -z "${TMPDIR:-}" ] && [ -w /dev/shm ] && [ "${room:-0}" -ge $((32768 * count)) ]; then export TMPDIR=/dev/shm; fi
seq 0 $((count - 1)) | xargs -P "$count" -I{} env OXL_TEST_SHARE={}/"$count" "$@" |
    awk -v processes="$count" '
        /^[0-9]+ passed, [0-9]+ failed, [0-9]+ skipped$/ { passed += $1; failed += $3; skipped += $5; ended++; next }
        { print; fflush() }
        END {
            if (ended != processes) { print "FAIL: " processes - ended " of " processes " processes did not end"; failed++ }
            printf "%d passed, %d failed, %d skipped\n", passed, failed, skipped
            exit failed > 0
        }'
