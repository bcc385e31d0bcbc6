#!/bin/sh
# forecast.sh PROGRAM PRESET PX SURVEY... - what `check` predicts and what `train` takes, a line of a Markdown table for each survey:
# Gaussians in thousands, peak memory in MB, seconds with one thread. The table is in docs/log/SCALE.md. On a busy machine the
# predicted seconds are the machine's, those taken the processor's.
set -eu
program=$1 preset=$2 px=$3
shift 3
at=$(mktemp -d)
trap 'rm -rf "$at"' EXIT
# The CPU seconds of the programs so far; not in a pipe, whose shell would count its own.
used() { times > "$at/times" && awk -F'[ms ]' 'NR == 2 { print 60 * $1 + $2 }' "$at/times"; }
number() { sed -n "s/^ *\"$1\": \([-0-9.e+]*\),*$/\1/p" "$2" | head -n 1; } # NAME FILE
for survey; do
    set -- "$survey" --preset "$preset" --max-side "$px" --threads 1
    "$program" check "$@" --json > "$at/check" 2>/dev/null
    used > "$at/before"
    "$program" train "$@" -o "$at/out" --quiet > /dev/null 2>&1
    used > "$at/after"
    echo "$(number predicted_gaussians "$at/check") $(number gaussians "$at/out/metrics.json")" \
        "$(number predicted_memory_bytes "$at/check") $(number peak_rss_bytes "$at/out/metrics.json")" \
        "$(number predicted_seconds "$at/check") $(cat "$at/before" "$at/after" | tr '\n' ' ')" |
        awk -v name="$(basename "$survey") $px $preset" '{ printf "| %s | %.1f, %.1f | %.2f | %.0f, %.0f | %.2f | %.0f, %.0f | %.2f |\n", name,
            $1 / 1e3, $2 / 1e3, $1 / $2, $3 / 1e6, $4 / 1e6, $3 / $4, $5, $7 - $6, $5 / ($7 - $6) }'
    rm -rf "$at/out"
done
