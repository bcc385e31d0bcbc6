#!/usr/bin/env bash
# exercises.sh FOLDER - the check of every step's exercise refuses the unchanged splat.c and accepts the solution in exercises.txt.
set -u
cd "$(dirname "$0")/../.." || exit 1
folder=$1 passed=0 failed=0
mkdir -p "$folder"
for n in 1 2 3 4 5 6 7 8 9 10; do
    picture=0
    rm -rf "$folder/$n" "$folder/$n.c"
    make -s "exercise-$n" EXERCISES_AT="$folder" PICTURE=$picture >"$folder/$n.log" 2>&1
    if ! grep -q '^  Nothing has changed yet' "$folder/$n.log"; then
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
    if [ "$n" = 7 ]; then # a wrong sign is refused
        sed 's/(dn\[i\] - dot(dn, n, size) \* n\[i\])/(dn[i] + dot(dn, n, size) * n[i])/' reference/splat.c >"$folder/wrong.c"
        mv "$folder/7.c" "$folder/solution.c" && mv "$folder/wrong.c" "$folder/7.c"
        make -s exercise-7 EXERCISES_AT="$folder" PICTURE=0 >"$folder/7.log" 2>&1
        grep -q '^  This is not the result' "$folder/7.log" || { echo 'FAIL exercise 7 accepts a wrong sign'; failed=$((failed + 1)); }
        mv "$folder/solution.c" "$folder/7.c"
    fi
    [ "$n" = 3 ] && picture=1 # this one trains, too, with images of the unchanged program: half a minute for all ten is too long
    make -s "exercise-$n" EXERCISES_AT="$folder" PICTURE=$picture >"$folder/$n.log" 2>&1
    if grep -q '^  expected' "$folder/$n.log" && { [ $picture = 0 ] || { [ -s "$folder/3/splat.bmp" ] && grep -q 'view: 29.*unchanged: 32' "$folder/3.log"; }; }; then
        passed=$((passed + 1))
    else
        cat "$folder/$n.log"
        echo "FAIL exercise $n refuses its solution"
        failed=$((failed + 1))
    fi
done
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
