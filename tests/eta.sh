#!/bin/sh
# eta.sh PROGRAM SURVEY [options of train]: the time left that a run reports, against the time that was left.
# Prints a line for each tenth of the run; fails where one from the first to the ninth is off by over 25 %.
# Not part of `make test`: on a busy machine nothing can be promised.
program=$1 survey=$2
shift 2
at=$(mktemp -d) || exit 2
trap 'rm -rf "$at"' EXIT
"$program" train "$survey" -o "$at/out" --progress json "$@" 2>&1 > "$at/result" | while IFS= read -r line; do
    case $line in
    *'"event": "progress"'*) printf '%s %s\n' "$(date +%s.%N)" "$line" ;;
    esac
done > "$at/progress"
end=$(date +%s.%N)
sed 's/[",:{}]/ /g' "$at/progress" | awk -v end="$end" '
    { for (i = 1; i < NF; i++) {
          if ($i == "iteration") n = $(i + 1)
          if ($i == "iterations") of = $(i + 1)
          if ($i == "seconds_left") left = $(i + 1) } }
    of && int(10 * n / of) > tenth {
        tenth = int(10 * n / of); was = end - $1; ratio = left / (was > 0 ? was : 1e-9)
        printf "%3d %% of the steps: %.1f s left as told, %.1f s as it was, %.2f times\n", 10 * tenth, left, was, ratio
        lines++
        if (tenth < 10 && (ratio > 1.25 || ratio < 1 / 1.25)) bad++ }
    END { if (bad || !lines) print "FAIL", bad + 0, "of", lines + 0; exit bad || !lines }'
