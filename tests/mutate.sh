#!/usr/bin/env bash
# tests/mutate.sh [N] [FIRST] - plants faults in the kernels, one at a time, and shows which ones the tests do not notice.
#
# A site is an operator or a comparison in the code of a kernel; every k-th is taken, so that N (36) of them are spread over all files. Each
# mutant is a copy of the tree, built without vectors and optimisation, and tried with the kernels' tests. FIRST (0) shifts the choice.
# Not a step of .ci/run: N builds take a quarter of an hour. The last line counts; survivors are shown as they read.
set -u
cd "$(dirname "$0")/.." || exit 1
wanted=${1:-36} first=${2:-0}
work=build/mutate
tests="tests/test_adam.c tests/test_extremes.c tests/test_gradient.c tests/test_loss.c tests/test_oracle.c tests/test_raster.c tests/test_train.c"
names='adam_ pixel_that extremes_are extremes_of gradient_ float_ loss_ binning_ raster_ renderer_ image_and plain_ negative_ double_kernels density_ a_step'
export OMP_NUM_THREADS=1 OMP_WAIT_POLICY=passive

# FILE LINE COLUMN OLD NEW: one for each place where code, not a comment or a declaration, has such an operator.
sites() {
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
    /\*\// { comment = 0 }' src/render/project.c src/render/bin.c src/render/raster.c src/render/loss.c src/render/adam.c src/train/density.c
}

mutate() { # FILE LINE COLUMN OLD NEW
    awk -v line="$2" -v at="$3" -v old="$4" -v new="$5" \
        'FNR == line { $0 = substr($0, 1, at - 1) new substr($0, at + length(old)) } { print }' "$1" >"$work/tree/$1"
}

try() {
    make -C "$work/tree" -j1 BUILD=build TESTS="$tests" CFLAGS='-O0 -DOXL_NO_SIMD' build/test >"$work/build.log" 2>&1 || return 2
    (cd "$work/tree" && timeout 600 build/test $names) >"$work/test.log" 2>&1
}

rm -rf "$work"
mkdir -p "$work/tree"
cp -r Makefile oceanxl.c oceanxl.h src cli lab tests fuzz "$work/tree"
try || { echo "the tests fail without any fault, see $work/test.log"; exit 1; }
sites >"$work/sites"
total=$(wc -l <"$work/sites")
step=$((total / wanted))
killed=0 survived=0 invalid=0
while IFS=$'\t' read -r file line at old new; do
    mutate "$file" "$line" "$at" "$old" "$new"
    try
    case $? in
        0)
            survived=$((survived + 1))
            echo "survived: $file:$line:$at '$old' became '$new': $(sed -n "${line}p" "$file" | sed 's/^ *//')"
            ;;
        2) invalid=$((invalid + 1)) ;;
        *) killed=$((killed + 1)); echo "noticed:  $file:$line:$at '$old' became '$new': $(grep -m1 ^FAIL "$work/test.log" || echo 'crash or no end')" ;;
    esac
    cp "$file" "$work/tree/$file"
done < <(awk -v step="$step" -v first="$first" -v wanted="$wanted" 'NR % step == (first % step) && n++ < wanted' "$work/sites")
echo "$((killed + survived)) faults of $total sites: $killed noticed, $survived survived ($invalid did not compile)"
