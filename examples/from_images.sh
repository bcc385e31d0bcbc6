#!/bin/sh
# from_images.sh IMAGES SURVEY [OUT] - from a folder of images to a model: COLMAP finds the cameras, OceanXL trains.
#
# Needs COLMAP (Debian: apt-get install colmap) and oceanxl (in the path, in build/, or OCEANXL=...). SURVEY gets images/ (a link), the database
# and sparse/0/ as text; OUT gets what `oceanxl train` leaves (SURVEY/out). What is there already is not done again.
#   CAMERA=OPENCV          the lens model; dome ports: OPENCV, very wide ones: OPENCV_FISHEYE
#   MATCHER=sequential     for video frames and long transects in the order of their names; exhaustive compares all pairs (up to 300 images)
#   PRESET=standard        draft, standard or paper
set -eu
[ $# -ge 2 ] || { sed -n '2,$ { /^#/!q; s/^# \{0,1\}//p }' "$0" >&2; exit 2; }
here=$(realpath "$(dirname "$0")")
images=$(realpath "$1") survey=$2 out=${3:-$2/out}
oceanxl=${OCEANXL:-$(command -v oceanxl || echo "$here/../build/oceanxl")}
command -v colmap >/dev/null || { echo 'from_images.sh: colmap is not there. fix: apt-get install colmap' >&2; exit 1; }
count=$(find "$images" -type f \( -iname '*.jpg' -o -iname '*.jpeg' -o -iname '*.png' \) | wc -l)
[ "$count" -ge 3 ] || { echo "from_images.sh: $images holds $count images (JPG or PNG), at least 3 are wanted" >&2; exit 3; }
matcher=${MATCHER:-$([ "$count" -le 300 ] && echo exhaustive || echo sequential)}
export QT_QPA_PLATFORM=offscreen # no screen is needed

mkdir -p "$survey/sparse"
[ -e "$survey/images" ] || ln -s "$images" "$survey/images"
if [ ! -f "$survey/sparse/0/points3D.bin" ]; then
    echo "COLMAP: $count images, lens model ${CAMERA:-OPENCV}, $matcher matching; its words go to $survey/colmap.log" >&2
    {
        colmap feature_extractor --database_path "$survey/database.db" --image_path "$images" --ImageReader.single_camera 1 \
            --ImageReader.camera_model "${CAMERA:-OPENCV}" --SiftExtraction.use_gpu 0
        colmap "${matcher}_matcher" --database_path "$survey/database.db" --SiftMatching.use_gpu 0
        colmap mapper --database_path "$survey/database.db" --image_path "$images" --output_path "$survey/sparse"
    } >"$survey/colmap.log" 2>&1 || { tail -n 5 "$survey/colmap.log" >&2; echo "from_images.sh: COLMAP failed, see $survey/colmap.log" >&2; exit 1; }
fi
[ -f "$survey/sparse/0/points3D.bin" ] || {
    echo "from_images.sh: COLMAP found no two images that belong together, see $survey/colmap.log" >&2
    echo "     fix: more overlap (60 % and more), sharper images, or MATCHER=exhaustive" >&2
    exit 1
}
[ -f "$survey/sparse/0/points3D.txt" ] ||
    colmap model_converter --input_path "$survey/sparse/0" --output_path "$survey/sparse/0" --output_type TXT >>"$survey/colmap.log" 2>&1
"$oceanxl" check "$survey"
"$oceanxl" train "$survey" -o "$out" --preset "${PRESET:-standard}"
