#!/bin/sh
# demo.sh PROGRAM FOLDER - a synthetic survey, made, trained and evaluated. `make demo` runs it.
set -eu
program=$1 folder=$2
echo "demo 1/3: a synthetic underwater survey in $folder/survey"
"$program" synth -o "$folder/survey" --views 40 --size 320x240 --water 1C
echo "demo 2/3: training a model of it in $folder/out"
"$program" train "$folder/survey" -o "$folder/out" --preset draft
echo "demo 3/3: evaluating it on held-out images"
"$program" eval "$folder/out/scene.ply" "$folder/survey"
echo
echo "The model:    $folder/out/scene.ply (for other viewers: scene_standard.ply beside it, when it is there)"
echo "Images: $folder/out/renders/ (NAME.png the render, NAME.image.png the image)"
