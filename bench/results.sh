#!/bin/sh
# results.sh OUT SURVEY... [options] - the published tables and their plot by one command: `oceanxl results`, then OUT/speed.svg from its table
# and from OUT/others.csv (lines of NAME,CPU_SECONDS,PSNR of other programs), if it is there.
set -e
here=$(dirname "$0") out=$1
shift
"$here/../build/oceanxl" results "$@" -o "$out"
commit=$(sed -n 's/.*, commit \([0-9a-f]*\),.*/\1/p' "$out/results.md" | head -n 1)
[ -e "$out/others.csv" ] && others=$out/others.csv || others=/dev/null
awk -v commit="$commit" -f "$here/speed_plot.awk" "$out/results.csv" "$others" >"$out/speed.svg"
echo "written   $out/speed.svg"
