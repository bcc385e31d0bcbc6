#!/usr/bin/env bash
# exercises.sh FOLDER - the check of every step's exercise refuses the unchanged splat.c and accepts the solution in exercises.txt.
set -u
cd "$(dirname "$0")/../.." || exit 1
folder=$1 passed=0 failed=0
mkdir -p "$folder"
for n in 1 2 3 4 5 6 7 8 9 10; do
    picture=0
    rm -rf "$folder/$n" "$folder/$n.c"
    if make -s "exercise-$n" EXERCISES_AT="$folder" PICTURE=$picture >"$folder/$n.log" 2>&1; then
        echo "FAIL exercise $n accepts the unchanged file"
        failed=$((failed + 1))
        continue
    fi
    awk -v n="$n" 'FNR == NR {
            if ($0 ~ /^exercise: /) here = substr($0, 11) == n
            if (here && /^at: /) at = substr($0, 5)
            if (here && /^from: /) from = substr($0, 7)
            if (here && /^to: /) to = substr($0, 5)
            next
        }
        index($0, at) && (i = index($0, from)) { $0 = substr($0, 1, i - 1) to substr($0, i + length(from)); changed++ }
        { print }
        END { exit changed != 1 }' examples/course/exercises.txt reference/splat.c >"$folder/$n.c" ||
        { echo "FAIL exercise $n: not one line of splat.c matches at and from"; failed=$((failed + 1)); continue; }
    [ "$n" = 3 ] && picture=1 # this one trains, too: half a minute for all ten is too long
    if make -s "exercise-$n" EXERCISES_AT="$folder" PICTURE=$picture >"$folder/$n.log" 2>&1 && [ $picture = 0 -o -s "$folder/3/splat.ppm" ]; then
        passed=$((passed + 1))
    else
        cat "$folder/$n.log"
        echo "FAIL exercise $n refuses its solution"
        failed=$((failed + 1))
    fi
done
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
