#!/bin/sh
# from_images.sh - what examples/from_images.sh promises, without COLMAP, ffmpeg and training: programs of those names in a folder of the path
# do as WORLD says. Prints one line a promise, then a sum.
set -u
script=$(realpath "$(dirname "$0")/../examples/from_images.sh")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 130' INT TERM
cd "$folder" || exit 1
passed=0 failed=0

promise() { # NAME CODE WORDS COMMAND...: the command ends with the code, and what it prints holds the words
    name=$1 code=$2 words=$3
    shift 3
    "$@" >out.txt 2>&1 </dev/null
    seen=$?
    cp out.txt before.txt # the next promise may be of it, too
    if [ "$seen" = "$code" ] && { [ -z "$words" ] || grep -qF -- "$words" out.txt; }; then
        passed=$((passed + 1))
        echo "ok   from_images_$name"
    else
        failed=$((failed + 1))
        echo "FAIL from_images_$name: exit $seen, expected $code with '$words'; it printed:"
        head -n 20 out.txt
    fi
}

mkdir -p bin bare photos few empty
for name in sh sed awk grep cut sort comm wc find mkdir rm mv ln ls cat cp date sleep kill head tail paste realpath dirname getconf env tr; do
    ln -s "$(command -v $name)" bare/ 2>/dev/null
done
for name in a b c 'd e'; do echo x >"photos/$name.jpg"; done
cp photos/a.jpg few
echo x >dive.mp4

# WORLD: "nothing", the mapper fails as where no two photos fit; "two", it fails behind two models, of 1 and 3 photos; "new", options of 3.13.
cat >bin/colmap <<'END'
#!/bin/sh
echo "colmap $*" >>calls.txt
for word in "$@"; do
    case ${before:-} in
    --output_path) out=$word ;;
    --path | --input_path) in=$word ;;
    esac
    before=$word
done
model() { # FOLDER NAME...
    mkdir -p "$1" && echo "# images" >"$1/images.txt" && : >"$1/points3D.bin"
    at=$1
    shift
    for photo in "$@"; do printf '1 1 0 0 0 0 0 0 1 %s\n\n' "$photo"; done >>"$at/images.txt"
}
case "$1 $2" in
*" -h") [ "${WORLD:-}" = new ] && printf '  --FeatureExtraction.use_gpu\n  --FeatureMatching.use_gpu\n' ;;
feature_extractor*)
    [ "${WORLD:-}" != slow ] || for i in 1 2 3 4 5 6 7 8 9; do for k in 1 2 3 4 5; do sleep 1; done; done
    [ "${WORLD:-}" != broken ]
    ;;
mapper*)
    [ "${WORLD:-}" != nothing ] || { echo "ERROR: failed to create sparse model"; exit 1; }
    [ "${WORLD:-}" != two ] || { model "$out/0" a.jpg && model "$out/1" a.jpg b.jpg 'd e.jpg'; exit 1; }
    model "$out/0" a.jpg b.jpg c.jpg 'd e.jpg'
    ;;
model_analyzer*) echo "Registered images: $(grep -c jpg "$in/images.txt")" ;;
model_converter*) cp "$in/images.txt" "$out" && : >"$out/points3D.txt" ;;
esac
END
printf '#!/bin/sh\necho "oceanxl $*"\n' >bin/oceanxl
printf '#!/bin/sh\nexec %s 0.05\n' "$(command -v sleep)" >bin/sleep
chmod +x bin/*
mkdir with_ffmpeg
cat >with_ffmpeg/ffmpeg <<'END'
#!/bin/sh
for at in "$@"; do :; done # the last word, FOLDER/%06d.jpg
at=${at%/*}
for i in 1 2 3 4 5 6 7 8; do head -c $((i % 2 * 40 + 10)) /dev/zero >"$at/$i.jpg"; done
END
chmod +x with_ffmpeg/ffmpeg
run() { env PATH="$folder/bin:$folder/bare" "$script" "$@"; }
world() { # WORLD COMMAND...
    env WORLD="$1" PATH="$folder/bin:$folder/bare" "$script" "$2" "$3"
}
setting() { # NAME=VALUE...: of the environment
    env "$@" PATH="$folder/bin:$folder/bare" "$script" photos set
}

promise without_arguments_prints_how_to_call_it 2 'PHOTOS SURVEY [OUT]' run
promise names_a_folder_that_is_not_there 3 'nowhere is not there' run nowhere survey
promise wants_colmap 1 'fix: apt-get install colmap' env PATH="$folder/bare" "$script" photos survey
promise wants_oceanxl 1 'fix: make' env PATH="$folder/bin:$folder/bare" OCEANXL=none "$script" photos survey
promise wants_three_photos 3 'holds 1 photos' run few survey
promise leaves_no_link_to_a_wrong_folder 0 'oceanxl train survey' run photos survey
promise trains_behind_the_check 0 'oceanxl train survey -o survey/out --preset standard' sh -c 'grep -x "oceanxl check survey" before.txt && cat before.txt'
promise finds_all_photos 0 '4 of 4 photos have a camera' run photos survey
promise asks_colmap_once 0 '' sh -c 'test $(grep -c "colmap mapper" calls.txt) = 1'
promise refuses_images_of_another_folder 3 'survey has images of another folder' sh -c 'mkdir -p others && cp photos/* others && "$@"' sh env PATH="$folder/bin:$folder/bare" "$script" others survey
promise says_what_to_do_where_nothing_fits 1 'fix: sharper photos' world nothing photos nothing
promise shows_the_end_of_colmaps_log 1 'failed to create sparse model' world nothing photos nothing
promise says_which_stage_failed 1 'COLMAP failed: features' world broken photos broken
promise goes_on_where_the_mapper_left_models 0 '3 of 4 photos have a camera' world two photos two
promise takes_the_largest_model_and_names_the_others 0 'without one: c.jpg' run photos two
promise keeps_the_smaller_model 0 '' test -d two/sparse/0.smaller
promise knows_the_options_before_colmap_3_13 0 '--SiftMatching.use_gpu 0' sh -c '! grep -q Feature.*use_gpu calls.txt && cat calls.txt'
promise knows_the_options_since_colmap_3_13 0 'feature_extractor' sh -c 'rm -f calls.txt; "$@" && grep -q -- "--FeatureExtraction.use_gpu 0" calls.txt && grep -q -- "--FeatureMatching.use_gpu 0" calls.txt && cat calls.txt' sh \
    env WORLD=new PATH="$folder/bin:$folder/bare" "$script" photos recent
promise gives_masks_to_colmap 0 '--ImageReader.mask_path masks' sh -c 'mkdir -p masks && MASKS=masks "$@" && test -e masked/masks && cat calls.txt' sh \
    env PATH="$folder/bin:$folder/bare" "$script" photos masked
mkdir many
for i in 0 1 2 3 4 5 6 7 8; do for k in 0 1 2 3 4 5 6 7 8 9; do cp photos/a.jpg many/p$i$k.jpg; done; done
promise times_the_first_pairs 0 'pairs took' run many large
promise closes_loops_of_a_sequence 0 'loops' sh -c 'test "$(wc -l <large/pairs.txt)" = 36 && grep -qx "p00.jpg p80.jpg" large/pairs.txt && cat before.txt'
promise says_progress_without_a_terminal 0 '1/4 features: ..., ' setting WORLD=slow EVERY=1
promise refuses_an_unknown_matcher 2 'MATCHER=all is not known' setting MATCHER=all
promise wants_a_vocabulary_tree 2 'fix: VOCAB=FILE' setting MATCHER=vocab_tree
promise of_a_video_wants_ffmpeg 1 'fix: apt-get install ffmpeg' run dive.mp4 filmed
promise keeps_the_sharper_frame_of_each_two 0 '' sh -c '"$@"; test "$(ls filmed/images | tr -d "\n")" = 1.jpg3.jpg5.jpg7.jpg' sh \
    env PATH="$folder/with_ffmpeg:$folder/bin:$folder/bare" "$script" dive.mp4 filmed
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
