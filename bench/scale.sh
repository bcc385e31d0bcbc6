#!/bin/sh
# scale.sh PROGRAM FOLDER POINTS... - how `oceanxl partition` grows with the survey and with the number of blocks.
#
# For each number of points a synthetic survey (1000 points an image, but 20 images at least), cut into 1, 4, 16 and 64
# blocks, and as by default. Surveys and blocks go to FOLDER and are removed: 10^7 points take 3 GB of text and up to 6 GB of blocks.
# A survey that stands in FOLDER/survey.POINTS is taken as it is, and stays. A table on standard output, tabs between, as in
# docs/log/scale.tsv. Wants GNU time and awk.
set -eu
program=$1 folder=$2
shift 2
export LC_ALL=C

measured() { # appends wall, user, system seconds and peak memory in MB to the line
    /usr/bin/time -f '%e %U %S %M' -o "$folder/time" "$@" >"$folder/log" 2>&1 || { cat "$folder/log" >&2; exit 1; }
    awk '{ printf "%.2f\t%.2f\t%.2f\t%.1f", $1, $2, $3, $4 * 1024 / 1e6 }' "$folder/time"
}

mkdir -p "$folder"
printf '#what\tpoints\timages\ttracks\ttext MB\tblocks\twall s\tuser s\tsystem s\tpeak MB\n'
for points in "$@"; do
    images=$((points / 1000 > 20 ? points / 1000 : 20))
    survey=$folder/survey.$points ours=0
    if [ ! -d "$survey" ]; then
        ours=1
        made=$(measured "$program" synth -o "$survey" --no-images --points "$points" --views "$images" --quiet)
    fi
    mb=$(cat "$survey"/sparse/0/*.txt | wc -c | awk '{ printf "%.1f", $1 / 1e6 }')
    tracks=$(awk '/mean track length/ { printf "%.0f", $5 * $NF; exit }' "$survey/sparse/0/points3D.txt")
    [ $ours = 0 ] || printf 'synth\t%s\t%s\t%s\t%s\t0\t%s\n' "$points" "$images" "$tracks" "$mb" "$made"
    for size in $points $((points * 5 / 16)) $((points * 5 / 64)) $((points * 5 / 256)) 40000; do # a quarter above the wanted share
        took=$(measured "$program" partition "$survey" -o "$folder/out" --block-points "$size" --quiet)
        blocks=$(ls "$folder/out/blocks" | wc -l)
        printf 'partition\t%s\t%s\t%s\t%s\t%s\t%s\n' "$points" "$images" "$tracks" "$mb" "$blocks" "$took"
        rm -rf "$folder/out"
    done
    [ $ours = 0 ] || rm -rf "$survey"
done
rm -f "$folder/time" "$folder/log"
