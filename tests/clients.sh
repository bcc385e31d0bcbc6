#!/bin/sh
# clients.sh PROGRAM - other people's readers open every model file that we write, and `render` draws what they write.
# Needs node and npm, which fetches @playcanvas/splat-transform 3.7.0 and gsplat 1.2.9 (CLIENTS=folder keeps them for the next time).
set -eu
program=$(realpath "${1:-build/oceanxl}")
here=$(realpath "$(dirname "$0")")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
clients=${CLIENTS:-$folder/clients}
mkdir -p "$clients"
clients=$(realpath "$clients")
[ -d "$clients/node_modules/gsplat" ] ||
    (cd "$clients" && npm init -y >/dev/null && npm install --silent --ignore-scripts @playcanvas/splat-transform@3.7.0 gsplat@1.2.9 >/dev/null)
transform=$clients/node_modules/.bin/splat-transform
cp "$here/clients.mjs" "$clients/"
cd "$folder"
"$program" synth -o survey --views 16 --size 96x64 --points 1500 --origin 40,-30,5 --quiet >/dev/null
"$program" train survey -o out --iterations 200 --dog selective --dog-threshold 50% --threads 1 --quiet >/dev/null
"$program" convert out/scene.ply scene.splat 2>/dev/null >/dev/null
"$program" train survey -o flat --iterations 100 --sh-degree 1 --threads 1 --quiet >/dev/null

# count FILE: Gaussians, as splat-transform counts them.
count() { "$transform" -q "$1" null --info json | sed -n 's/.*"numGaussians": \([0-9]*\).*/\1/p'; }
wanted=$("$program" info out/scene.ply --json | sed -n 's/.*"gaussians": \([0-9]*\).*/\1/p')
for file in out/scene.ply out/scene_standard.ply scene.splat; do
    [ "$(count $file)" = "$wanted" ] || { echo "FAIL splat-transform counts $(count $file) Gaussians in $file, wanted $wanted"; exit 1; }
    echo "ok   splat-transform reads $file"
done
[ -n "$(count flat/scene.ply)" ] && [ "$(count flat/scene.ply)" = "$(count flat/scene_standard.ply)" ] && echo "ok   splat-transform reads one band of harmonics"

# gsplat knows no element but vertex: the files for any viewer.
for file in out/scene_standard.ply flat/scene_standard.ply; do "$program" info $file --json >$file.json; done
"$program" info scene.splat --json >scene.splat.json
node "$clients/clients.mjs" out/scene_standard.ply flat/scene_standard.ply scene.splat

psnr() { "$program" eval "$1" survey --json 2>/dev/null | sed -n 's/^  "psnr": \([0-9.]*\),$/\1/p'; }

# There and back: what splat-transform writes is drawn as what it read. The files leave the origin out, so the test puts it back.
"$transform" -q out/scene_standard.ply back.ply
"$transform" -q out/scene_standard.ply packed.compressed.ply
"$transform" -q packed.compressed.ply unpacked.ply
for file in back unpacked; do
    origin=$(sed -n '/^comment origin/{p;q}' out/scene_standard.ply)
    LC_ALL=C sed "1,/^format/s/^\(format.*\)/\1\n$origin/" $file.ply >placed.ply
    psnr out/scene_standard.ply >ours.txt
    psnr placed.ply >theirs.txt
    awk -v name=$file 'NR == FNR { ours = $1; next } { seen = 1; d = ours - $1; if (d < 0) d = -d; limit = name == "back" ? 0.001 : 0.5
        print (d <= limit ? "ok  " : "FAIL"), "render of", name ".ply, as splat-transform wrote it:", $1, "dB, wanted", ours; bad = d > limit } END { exit bad || !seen }' ours.txt theirs.txt
done
