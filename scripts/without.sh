#!/bin/sh
# without.sh PART|all [WORD...] - removes a part of training, its file and its row, in a copy of the tree (build/without/PART), builds it,
# and runs the tests whose names contain one of the words (all). Tests that need the part say so (NEEDS_PART) and are skipped.
# all: each part in turn, JOBS (2) at a time: one line a part, and what failed; the output is in build/without/PART.log.
#
# Objects are taken from build/dev, so that no more is compiled than what the removal changes: the proof is that it links and works.
set -eu
cd "$(dirname "$0")/.."
part=${1:-}
[ $# = 0 ] || shift
parts=$(sed -n 's/^ *ROW(\([a-z_]*\)).*/\1/p' src/parts/parts.h)
if [ "$part" != all ] && ! [ -e "src/parts/$part.c" ]; then
    echo "without: src/parts has no $part.c; parts are: all" $parts >&2
    exit 2
fi
[ "${WITHOUT_READY:-}" ] || make -s DEV=1 build/dev/oceanxl build/dev/test

if [ "$part" = all ]; then
    export WITHOUT_READY=1
    mkdir -p build/without
    # shellcheck disable=SC2016
    echo $parts | tr ' ' '\n' | xargs -P "${JOBS:-2}" -I PART sh -c '
        part=$1 log=build/without/$1.log
        shift
        code=0
        scripts/without.sh "$part" "$@" >"$log" 2>&1 || code=$?
        line=$(grep "^[0-9]* passed, [0-9]* failed" "$log" || echo "0 passed, 1 failed")
        echo "$line: without $part"
        [ $code = 0 ] || { grep -A4 "^FAIL\|error:" "$log" | head -n 20; tail -n 3 "$log"; exit 1; }' without.sh PART "$@"
    exit
fi

tree=build/without/$part
rm -rf "$tree"
mkdir -p "$tree/build"
tar -cf - --exclude=./build --exclude=./dist --exclude=./demo --exclude=./.git . | tar -xf - -C "$tree"
cp -a build/dev "$tree/build/dev"
cd "$tree"
rm -f "src/parts/$part.c" "src/parts/$part.h" "tests/test_$part.c" "build/dev/src/parts/$part".* "build/dev/tests/test_$part".*
sed -i "/ROW($part) /d; s/ROW($part)\$//" src/parts/parts.h
sed -i "/src\/parts\/$part\.c/d" oceanxl.c
grep -q "ROW($part)" src/parts/parts.h && { echo "without: the row of $part is still there" >&2; exit 1; }
make -s DEV=1 build/dev/oceanxl build/dev/test
build/dev/test "$@"
