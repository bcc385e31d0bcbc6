#!/usr/bin/env bash
# ladder.sh FOLDER CC FLAGS... - compiles the renderers in ladder/ (the library with LIBS), times them, and prints a table. Every rung must draw what the first one
# draws, within MOST grey levels, and have at most 60 lines that the rung before it has not. RUNGS="1_double 3_tiles" for some of them.
set -u
cd "$(dirname "$0")/../.." || exit 1
folder=$1 ladder=examples/course/ladder previous="" cpu1="" wall1="" failed=0
shift
mkdir -p "$folder"
MOST=1.6 # a splat whose alpha is at 1/255 in float and below it in double adds a grey level
names=([1]='plain double' 'float' 'tiles' 'one global sort' 'packs of 16 pixels' 'threads' 'the library')
printf '| rung | new lines | CPU ms | speed-up | wall ms | speed-up | largest difference, grey levels |\n|---|--:|--:|--:|--:|--:|--:|\n'
for source in "$ladder"/[1-7]_*.c; do
    name=$(basename "$source" .c) number=${name%%_*} lines=0
    [ -z "$previous" ] || lines=$(diff "$previous" "$source" | grep -c '^>')
    [ -n "$previous" ] || lines=$(wc -l <"$source")
    previous=$source
    [ "$lines" -le 60 ] || { echo "FAIL $name has $lines new lines, 60 are allowed"; failed=1; }
    library=""
    [ "$number" != 7 ] || library="$folder/../liboceanxl.a ${LIBS:-}"
    "$@" -I. "$source" $library -o "$folder/$name" -lm || { failed=1; continue; }
    read -r _ cpu wall difference < <("$folder/$name" "$number" "$folder/truth.raw") || { echo "FAIL $name"; failed=1; continue; }
    awk -v n="${names[$number]}" -v l="$lines" -v c="$cpu" -v w="$wall" -v c1="${cpu1:=$cpu}" -v w1="${wall1:=$wall}" -v d="$difference" \
        'BEGIN { printf "| %s | %d | %.2f | %.1f x | %.2f | %.1f x | %.2f |\n", n, l, c, c1 / c, w, w1 / w, d }'
    awk -v d="$difference" -v most=$MOST 'BEGIN { exit !(d <= most) }' || { echo "FAIL $name draws another image"; failed=1; }
done
rm -f "$folder/truth.raw"
exit $failed
