#!/bin/sh
# demo.sh PROGRAM FOLDER - a synthetic survey, made, trained and judged. `make demo` runs it.
set -eu
program=$1 folder=$2
echo "demo 1/3: a synthetic underwater survey in $folder/survey"
"$program" synth -o "$folder/survey" --views 40 --size 320x240 --water 1C
echo "demo 2/3: training a model of it in $folder/out"
"$program" train "$folder/survey" -o "$folder/out" --preset draft
echo "demo 3/3: judging it on photographs that it did not see"
"$program" eval "$folder/out/scene.ply" "$folder/survey"
echo
echo "The model:    $folder/out/scene.ply (for other viewers: scene_standard.ply beside it, when it is there)"
echo "The pictures: $folder/out/renders/ (NAME.png drawn, NAME.photo.png the photograph)"
