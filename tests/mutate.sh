#!/usr/bin/env bash
# tests/mutate.sh [N] [FIRST] - plants faults in the kernels, one at a time, and shows which ones the tests do not notice.
# tests/mutate.sh constants [NAME...] - changes their constants, and runs the comparison with reference/splat.c and what it lacks: each must be noticed.
#
# A site is an operator or a comparison in the code of a kernel; every k-th is taken, so that N (36) of them are spread over all files. FIRST
# (0) shifts the choice. Of constants all are taken (or those named): a real number becomes 1.1 times itself, a whole one its successor; of an
# array of whole numbers the first in each line. Each mutant is a copy of the tree, built without vectors and optimisation, and tried with the
# kernels' tests. Not a step of .ci/run: a build and a run take half a minute. The last line counts; survivors are shown as they read. With constants
# the exit code is 1 when one survives.
set -u
cd "$(dirname "$0")/.." || exit 1
work=build/mutate
formulas=$(find src -name project.c -o -name colour.h -o -name bin.c -o -name raster.c -o -name loss.c -o -name adam.c -o -name density.c | sort)
kernels="$formulas $(find src/render -name 'medium.[ch]' -o -name exposure.c -o -name depth_loss.c | sort)"
constants=$(find src -name kernels.h -o -name real.h)
# How much room there is, how the work is cut up, how finely a threshold is searched, margins of tests that are exact later, and the last of
# some names: a larger number changes no result, by the invariants at the top of their files.
sizes='TILE_PIXELS TILE_SUBTILES SPLAT_SUMS LOSS_GAP LOSS_MAPS LOSS_PRODUCT LOSS_DERIVATIVES LOSS_SUMS BIN_PARTS BIN_PART_MIN BIN_NARROW
BIN_RADIX_BITS RASTER_BATCH PROJECT_HUGE DENSITY_CAP_HIGH DENSITY_CAP_LOW DENSITY_CAP_GEOMETRIC DENSITY_CAP_ROUNDS
BIN_CONTOUR_FACTOR BIN_CONTOUR_MARGIN BIN_SLACK BIN_SLACK_FRACTION PROJECT_BOX_FACTOR PROJECT_BOX_MARGIN ADAM_GRADIENT_MAX'
export OMP_NUM_THREADS=1 OMP_WAIT_POLICY=passive

# FILE LINE COLUMN OLD NEW: one for each place where code, not a comment or a declaration, has such an operator.
operators() {
    awk '
    BEGIN { split(" + | - | * | < | > | >= | <= | += |(real)0.5|(real)-0.5", old, "|")
            split(" - | + | + | >= | <= | > | < | -= |(real)0.25|(real)0.5", new, "|") }
    /\/\*/ { comment = 1 }
    !comment && !/^#/ && !/^static const/ && !/for \(/ && !/prefetch/ {
        for (i = 1; i <= 10; i++) {
            at = index($0, old[i])
            if (at) printf "%s\t%d\t%d\t%s\t%s\n", FILENAME, FNR, at, old[i], new[i]
        }
    }
    /\*\// { comment = 0 }' $kernels
}

# The same for constants, with the name before it.
numbers() { # NAMES TO LEAVE OUT, NAMES TO TAKE (all)
    awk -v out=" $(echo $1) " -v only=" $2 " '
    function number(name, from, real,    text) { # returns where it ends
        text = substr($0, from)
        sub(/\/\*.*/, "", text)
        if (index(out, " " name " ") || (only != "  " && !index(only, " " name " "))) return 0
        if (text ~ /<<|\+/ || !match(text, /[0-9]+(\.[0-9]*)?(e[-+]?[0-9]+)?/)) return 0
        real = real || substr(text, RSTART, RLENGTH) ~ /[.e]/
        printf "%s\t%s\t%d\t%d\t%s\t%s\n", name, FILENAME, FNR, from + RSTART - 1, substr(text, RSTART, RLENGTH),
            real ? sprintf("%.17g", 1.1 * substr(text, RSTART, RLENGTH)) : substr(text, RSTART, RLENGTH) + 1
        return from + RSTART - 1 + RLENGTH
    }
    /^#define [A-Z0-9_]+ / { number($2, index($0, $2) + length($2), /\(real\)/) }
    /^static const real/ { array = $4; sub(/\[.*/, "", array); number(array, index($0, "=") + 1, !/\{\{/) }
    array && !/^static const real/ { at = number(array, 1, /\(real\)/); while (at && /\(real\)/) at = number(array, at, 1) }
    /;$/ { array = "" }' $constants $formulas
}

mutate() { # FILE LINE COLUMN OLD NEW
    awk -v line="$2" -v at="$3" -v old="$4" -v new="$5" \
        'FNR == line { $0 = substr($0, 1, at - 1) new substr($0, at + length(old)) } { print }' "$1" >"$work/tree/$1"
}

try() {
    make -C "$work/tree" -j1 BUILD=build WERROR= TESTS="$tests" CFLAGS='-O0 -DOXL_NO_SIMD' build/test >"$work/build.log" 2>&1 || return 2
    (cd "$work/tree" && timeout 600 build/test $names) >"$work/test.log" 2>&1
}

plant() { # FILE LINE COLUMN OLD NEW [NAME]
    local what="$1:$2:$3 ${6:-} '$4' became '$5'"
    mutate "${@:1:5}"
    try
    case $? in
        0)
            survived=$((survived + 1))
            echo "survived: $what: $(sed -n "$2p" "$1" | sed 's/^ *//')"
            ;;
        2) invalid=$((invalid + 1)); echo "invalid:  $what: $(grep -m1 error: "$work/build.log")" ;;
        *) killed=$((killed + 1)); echo "noticed:  $what: $(grep -m1 ^FAIL "$work/test.log" || echo 'crash or no end')" ;;
    esac
    cp "$1" "$work/tree/$1"
}

tests=$(echo tests/test_*.c)
names='adam_ pixel_ extremes_are extremes_of gradient_ float_ loss_ binning_ raster_ renderer_ image_and plain_ negative_ density_ a_step reference_
medium_gradients medium_baked medium_alone lamp_gradients depth_loss medium_lamp_and_gains exposure_gradient exposure_gains'
# Depths and resets of opacity are not in reference/splat.c.
[ "${1:-}" = constants ] && tests="tests/test_reference.c tests/test_depth.c tests/test_train.c" names="reference_ depth_ density_reset"
rm -rf "$work"
mkdir -p "$work/tree"
cp -r Makefile oceanxl.c oceanxl.h oceanxl_job.h examples src backends cli lab tools bench reference tests fuzz "$work/tree"
try || { echo "the tests fail without any fault, see $work/build.log, $work/test.log"; exit 1; }
killed=0 survived=0 invalid=0
if [ "${1:-}" = constants ]; then
    numbers "$sizes" "${*:2}" >"$work/sites"
    while IFS=$'\t' read -r name file line at old new; do plant "$file" "$line" "$at" "$old" "$new" "$name"; done <"$work/sites"
    echo "$((killed + survived)) constants: $killed noticed, $survived survived ($invalid did not compile)"
    [ $survived = 0 ]
else
    wanted=${1:-36} first=${2:-0}
    operators >"$work/sites"
    total=$(wc -l <"$work/sites")
    step=$((total / wanted))
    while IFS=$'\t' read -r file line at old new; do
        plant "$file" "$line" "$at" "$old" "$new"
    done < <(awk -v step="$step" -v first="$first" -v wanted="$wanted" 'NR % step == (first % step) && n++ < wanted' "$work/sites")
    echo "$((killed + survived)) faults of $total sites: $killed noticed, $survived survived ($invalid did not compile)"
fi
