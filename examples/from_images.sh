#!/bin/sh
# from_images.sh PHOTOS SURVEY [OUT] - from a folder of photos, or a video, to a model: COLMAP finds the cameras, OceanXL trains.
#
# Needs COLMAP (Debian: apt-get install colmap; ffmpeg for a video) and oceanxl (in the path, in build/, or OCEANXL=...). SURVEY gets images/,
# COLMAP's database and log, and sparse/0/; OUT (SURVEY/out) what `oceanxl train` leaves. What is there already is not done again.
#   CAMERA=OPENCV       the lens model; SIMPLE_RADIAL for few photos, OPENCV_FISHEYE for very wide lenses
#   SINGLE_CAMERA=1     0: photos of several cameras or zoom settings
#   MATCHER=exhaustive  all pairs: up to 80 photos; sequential: a video, or photos in the order of their names, each with the next 10, and
#                       every tenth with every other tenth, where a path comes back: beyond 80; spatial: by their GPS tags; vocab_tree: any order, with VOCAB=FILE, a vocabulary tree from COLMAP's page
#   MASKS=FOLDER        NAME.png beside each photo's NAME, black is ignored, by COLMAP and in training; SURVEY/masks if it is there
#   FPS=2               frames a second that are taken of a video: of each two candidates the one with more detail
#   PRESET=standard     draft, standard or paper
set -eu
[ $# -ge 2 ] || { sed -n '2,$ { /^#/!q; s/^# \{0,1\}//p }' "$0" >&2; exit 2; }
here=$(realpath "$(dirname "$0")")
say() { echo "from_images.sh: $*" >&2; }
fix() { echo "     fix: $*" >&2; }
[ -e "$1" ] || { say "$1 is not there"; fix 'a folder of photos (JPG or PNG), or a video'; exit 3; }
photos=$(realpath "$1") survey=$2 out=${3:-$2/out}
oceanxl=${OCEANXL:-$(command -v oceanxl || echo "$here/../build/oceanxl")}
command -v colmap >/dev/null || { say 'colmap is not there'; fix 'apt-get install colmap'; exit 1; }
command -v "$oceanxl" >/dev/null || { say "$oceanxl is not there"; fix 'make, in the folder of OceanXL'; exit 1; }
export QT_QPA_PLATFORM=offscreen # no screen is needed
case ${MATCHER:-exhaustive} in
exhaustive | sequential | spatial) ;;
vocab_tree) [ -f "${VOCAB:-}" ] || { say "MATCHER=vocab_tree wants a vocabulary tree, VOCAB=${VOCAB:-}"; fix 'VOCAB=FILE, one from https://demuc.de/colmap'; exit 2; } ;;
*) say "MATCHER=$MATCHER is not known"; fix 'MATCHER=exhaustive, sequential, spatial or vocab_tree'; exit 2 ;;
esac
mkdir -p "$survey/sparse"
EVERY=${EVERY:-30} # s; between two lines where there is no terminal
log=$survey/colmap.log cores=$(getconf _NPROCESSORS_ONLN)
: >>"$log"

# run STAGE PATTERN COMMAND...: into the log; meanwhile the last line of it that has the pattern is shown, without a terminal each half minute.
run() {
    stage=$1 pattern=$2 begin=$(date +%s) before=0
    shift 2
    from=$(wc -l <"$log")
    echo "== $*" >>"$log"
    "$@" >>"$log" 2>&1 &
    process=$!
    while kill -0 $process 2>/dev/null; do
        sleep 1
        line=$(tail -n "+$((from + 1))" "$log" | grep -aEo "$pattern" | tail -n 1 || true)
        passed=$(($(date +%s) - begin))
        if [ -t 2 ]; then printf '\r\033[K%s: %s, %s s' "$stage" "${line:-...}" $passed >&2
        elif [ $((passed / EVERY)) -gt $((before / EVERY)) ]; then echo "$stage: ${line:-...}, $passed s" >&2; fi
        before=$passed
    done
    [ ! -t 2 ] || printf '\r\033[K' >&2
    if wait $process; then echo "$stage: $(($(date +%s) - begin)) s${line:+, $line}" >&2; else return 1; fi
}

failed() { # STAGE
    tail -n 5 "$log" >&2
    say "COLMAP failed: $1, see $log"
    fix "sharper photos, more overlap (60 % and more), MATCHER=exhaustive, or CAMERA=SIMPLE_RADIAL; remove $survey/database.db to begin anew"
    exit 1
}

# ---- a video: candidates at twice the rate, of which the larger JPEG of each two is kept: blur compresses better
if [ -f "$photos" ]; then
    command -v ffmpeg >/dev/null || { say 'ffmpeg is not there'; fix 'apt-get install ffmpeg'; exit 1; }
    if [ ! -d "$survey/images" ]; then
        rm -rf "$survey/frames"
        mkdir -p "$survey/frames"
        run 'video' 'frame= *[0-9]+' ffmpeg -nostdin -i "$photos" -vf "fps=$(awk "BEGIN { print 2 * ${FPS:-2} }")" -q:v 2 "$survey/frames/%06d.jpg" ||
            { tail -n 3 "$log" >&2; exit 1; }
        # shellcheck disable=SC2012
        ls -l "$survey/frames" | awk 'NR > 1 { n++; size[n] = $5; name[n] = $NF }
            END { for (i = 1; i < n; i += 2) print (size[i] >= size[i + 1]) ? name[i + 1] : name[i] }' |
            while read -r blurred; do rm -f "$survey/frames/$blurred"; done
        mv "$survey/frames" "$survey/images"
    fi
    photos=$(realpath "$survey/images")
    MATCHER=${MATCHER:-sequential}
fi
count=$(find "$photos/" -type f \( -iname '*.jpg' -o -iname '*.jpeg' -o -iname '*.png' \) | wc -l)
[ "$count" -ge 3 ] || { say "$photos holds $count photos (JPG or PNG), at least 3 are wanted"; fix 'the folder of the photos'; exit 3; }
if [ -e "$survey/images" ]; then
    [ "$(realpath "$survey/images")" = "$photos" ] || { say "$survey has images of another folder, $(realpath "$survey/images")"; fix 'another SURVEY'; exit 3; }
else ln -sfn "$photos" "$survey/images"; fi
masks=${MASKS:-$survey/masks}
[ ! -d "$masks" ] || [ -e "$survey/masks" ] || ln -s "$(realpath "$masks")" "$survey/masks"
matcher=${MATCHER:-$([ "$count" -le 80 ] && echo exhaustive || echo sequential)}

# ---- COLMAP; since 3.13 use_gpu is an option of FeatureExtraction and FeatureMatching
has() { colmap "$1" -h 2>&1 | grep -q -e "$2"; }
if ! ls "$survey"/sparse/*/points3D.bin >/dev/null 2>&1; then
    case $matcher in
    exhaustive) pairs=$((count * count)) ;;
    vocab_tree) pairs=$((count * 100)) ;;
    *) pairs=$((count * 10 + count * count / 200)) ;;
    esac
    [ "$pairs" -le $((count * (count - 1) / 2)) ] || pairs=$((count * (count - 1) / 2))
    say "$count photos, lens model ${CAMERA:-OPENCV}, $matcher matching: $pairs pairs"
    [ "$matcher" != sequential ] || [ "${MATCHER:-}" ] || say 'sequential matching takes photos in the order of their names; MATCHER=exhaustive compares all'
    extraction=SiftExtraction matching=SiftMatching
    ! has feature_extractor FeatureExtraction.use_gpu || extraction=FeatureExtraction
    ! has "${matcher}_matcher" FeatureMatching.use_gpu || matching=FeatureMatching
    set -- --database_path "$survey/database.db" --image_path "$photos" --ImageReader.single_camera "${SINGLE_CAMERA:-1}" \
        --ImageReader.camera_model "${CAMERA:-OPENCV}" "--$extraction.use_gpu" 0
    [ ! -d "$masks" ] || set -- "$@" --ImageReader.mask_path "$masks"
    run '1/4 features' 'Processed file \[[0-9]+/[0-9]+\]' colmap feature_extractor "$@" || failed features
    # COLMAP's lists of pairs have no names with spaces; its matchers do not match a pair again
    names() { (cd "$photos/" && find . -type f \( -iname '*.jpg' -o -iname '*.jpeg' -o -iname '*.png' \)) | sed 's,^\./,,' | grep -v ' ' | sort; }
    match_list() { colmap matches_importer --database_path "$survey/database.db" "--$matching.use_gpu" 0 --match_list_path "$1"; }
    names | awk -v most=$((2 * cores)) 'NR > 1 && NR <= most + 1 { print last, $0 } { last = $0 }' >"$survey/pairs.txt"
    timed=$(wc -l <"$survey/pairs.txt")
    if [ "$timed" -gt 0 ] && [ "$pairs" -gt $((4 * timed)) ]; then
        begin=$(date +%s%N)
        match_list "$survey/pairs.txt" >>"$log" 2>&1 || true
        awk -v t=$((($(date +%s%N) - begin) / 1000000)) -v n="$timed" -v all="$pairs" \
            'BEGIN { printf "from_images.sh: the first %d pairs took %.1f s: all take about %d min\n", n, t / 1000, t / 60000 / n * all + 1 }' >&2
    fi
    set -- --database_path "$survey/database.db" "--$matching.use_gpu" 0
    [ "$matcher" != vocab_tree ] || set -- "$@" --VocabTreeMatching.vocab_tree_path "$VOCAB"
    run '2/4 matches' 'Matching (block|image) \[[0-9/, ]+\]' colmap "${matcher}_matcher" "$@" || failed matches
    if [ "$matcher" = sequential ]; then
        names | awk 'NR % 10 == 1 { for (i = 1; i <= n; i++) print tenth[i], $0; tenth[++n] = $0 }' >"$survey/pairs.txt"
        [ ! -s "$survey/pairs.txt" ] || run '2/4 loops' 'Matching (block|image) \[[0-9/, ]+\]' match_list "$survey/pairs.txt" || failed matches
    fi
    run '3/4 cameras' 'Registering image #[0-9]+ \([0-9]+\)' colmap mapper --database_path "$survey/database.db" --image_path "$photos" \
        --output_path "$survey/sparse" || [ -f "$survey/sparse/0/points3D.bin" ] || failed 'no two photos fit together'
fi
ls "$survey"/sparse/*/points3D.bin >/dev/null 2>&1 || failed 'no two photos fit together'

# ---- the sub-model with most photos, in sparse/0; its text tells which photos they are
if [ ! -f "$survey/text/points3D.txt" ]; then
    best='' most=0
    for model in "$survey"/sparse/*/; do
        n=$(colmap model_analyzer --path "$model" 2>&1 | sed -n 's/.*Registered images: *//p')
        [ "${n:-0}" -le "$most" ] || { most=$n best=${model%/}; }
    done
    if [ "$best" != "$survey/sparse/0" ]; then
        mv "$survey/sparse/0" "$survey/sparse/0.smaller"
        mv "$best" "$survey/sparse/0"
    fi
    mkdir -p "$survey/text"
    colmap model_converter --input_path "$survey/sparse/0" --output_path "$survey/text" --output_type TXT >>"$log" 2>&1
fi
grep -v '^#' "$survey/text/images.txt" | awk 'NR % 2' | cut -d ' ' -f 10- | sort >"$survey/registered.txt"
(cd "$photos/" && find . -type f \( -iname '*.jpg' -o -iname '*.jpeg' -o -iname '*.png' \)) | sed 's,^\./,,' | sort >"$survey/photos.txt"
comm -13 "$survey/registered.txt" "$survey/photos.txt" >"$survey/unregistered.txt"
say "$(wc -l <"$survey/registered.txt") of $count photos have a camera"
if [ -s "$survey/unregistered.txt" ]; then
    say "without one: $(head -n 10 "$survey/unregistered.txt" | paste -sd ' '); all are in $survey/unregistered.txt"
    fix 'they overlap too little with the others, or are blurred; MATCHER=exhaustive may find more'
fi

# ---- OceanXL
echo '4/4 training' >&2
"$oceanxl" check "$survey"
"$oceanxl" train "$survey" -o "$out" --preset "${PRESET:-standard}"
