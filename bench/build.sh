#!/bin/sh
# build.sh - CPU seconds of builds, in a folder of its own (build/bench_build): from nothing, and after a change of one file. On a busy
# machine wall time is longer; CPU seconds hardly change.
set -eu
cd "$(dirname "$0")/.."
at=build/bench_build
rm -rf "$at"

# NAME LIMIT MAKE_ARGUMENT...: runs make, prints its CPU seconds, of children too, and what is wanted of it.
measure() {
    name=$1 limit=$2
    shift 2
    took=$( { sh -c 'make -s -j2 "$@" >/dev/null && times' build "$@"; } | awk 'NR == 2 { for (i = 1; i <= 2; i++) { split($i, t, /[ms]/); sum += 60 * t[1] + t[2] } printf "%.1f", sum }')
    printf '%s\t%s\t%s\n' "$name" "$took" "$limit" | awk -F'\t' '{ printf "%-44s %6.1f CPU s, wanted at most %s\n", $1, $2, $3 }'
}
touched() { touch "$1"; }

measure 'from nothing' 45 BUILD="$at" "$at/oceanxl"
touched src/train/density.c; measure 'after a change of src/train/density.c' 3 BUILD="$at" "$at/oceanxl"
touched src/render/raster.c; measure 'after a change of src/render/raster.c' 8 BUILD="$at" "$at/oceanxl"
measure 'tests, from the same objects' 60 BUILD="$at" "$at/test"
touched tests/test_train.c; measure 'after a change of tests/test_train.c' 5 BUILD="$at" "$at/test"
measure 'DEV=1 from nothing' 20 DEV=1 BUILD="$at/dev" "$at/dev/oceanxl"
touched src/train/density.c; measure 'DEV=1 after src/train/density.c' 2 DEV=1 BUILD="$at/dev" "$at/dev/oceanxl"
touched src/render/raster.c; measure 'DEV=1 after src/render/raster.c' 4 DEV=1 BUILD="$at/dev" "$at/dev/oceanxl"
rm -rf "$at"
