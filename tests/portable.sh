#!/usr/bin/env bash
# tests/portable.sh - other machines, C libraries and compilers: builds, and where something can run it, tests. Tools that are not
# installed are said and skipped; nothing that was skipped counts as passed.
#
# Debian: qemu-user-static, gcc-aarch64-linux-gnu, gcc-arm-linux-gnueabihf, gcc-s390x-linux-gnu (with their libc6-dev-*-cross), musl-tools,
# tcc, gcc-mingw-w64-x86-64, wine, wine64. WORDS="..." names the tests that run under the emulator.
set -u
cd "$(dirname "$0")/.." || exit 1
words=${WORDS:-number_ ply_ model_read model_write vecmath_ merge_ adam_ loss_is gradient_is float_ checkpoint_keeps colmap_points colmap_images os_}
export OMP_NUM_THREADS=1 OMP_WAIT_POLICY=passive
passed=0 failed=0 skipped=0
stb=/usr/include/stb

verdict() { # NAME CODE [TEXT]
    if [ "$2" = 0 ]; then passed=$((passed + 1)); echo "| $1 | passed | ${3:-} |"
    elif [ "$2" = skip ]; then skipped=$((skipped + 1)); echo "| $1 | skipped | ${3:-} |"
    else failed=$((failed + 1)); echo "| $1 | **failed** | ${3:-} |"; fi
}

has() { command -v "$1" >/dev/null; }

# NAME MACHINE EMULATOR: the library's tests, serial, on another machine.
emulated() {
    local name=$1 machine=$2 emulator=$3 build=build/portable/$2 code
    has "$emulator" || { verdict "$name" skip "no $emulator"; return; }
    OPENMP=0 CFLAGS=-O0 scripts/cross.sh "$machine" "$build" test >"$build.log" 2>&1
    case $? in
    0) ;;
    77) verdict "$name" skip "$(tail -n 1 "$build.log")"; return ;;
    *) verdict "$name" 1 "does not build, $build.log"; return ;;
    esac
    # shellcheck disable=SC2086
    "$emulator" "$build/test" $words >"$build.test" 2>&1
    code=$?
    verdict "$name" $code "$(tail -n 1 "$build.test") ($words)"
}

# MACHINE EMULATOR: as it is released: a survey trained there gives the bytes of this machine, which has fused multiply-add.
released() {
    local name="$1, same bytes" machine=$1 build=build/portable/released-$1 at=build/portable/bytes
    has "$2" || { verdict "$name" skip "no $2"; return; }
    scripts/cross.sh "$machine" "$build" oceanxl >"$build.log" 2>&1 || { verdict "$name" 1 "does not build, $build.log"; return; }
    make all >"$build.log" 2>&1
    rm -rf $at
    build/oceanxl synth -o $at/survey --views 10 --size 96x64 --points 800 --quiet >/dev/null &&
        build/oceanxl train $at/survey -o $at/here --iterations 300 --quiet >/dev/null 2>&1 &&
        "$2" "$build/oceanxl" train $at/survey -o $at/there --iterations 300 --quiet >/dev/null 2>&1 && cmp $at/here/scene.ply $at/there/scene.ply
    verdict "$name" $? 'scene.ply of 300 iterations'
}

# NAME COMMAND...: builds, no more.
compiles() {
    local name=$1 log=build/portable/${1//[^a-zA-Z0-9]/_}.log
    shift
    has "$1" || { verdict "$name" skip "no $1"; return; }
    "$@" >"$log" 2>&1
    verdict "$name" $? "compiles; not run"
}

mkdir -p build/portable/include
ln -sfn $stb build/portable/include/stb
echo '| target | verdict | what was done |'
echo '|---|---|---|'
emulated 'aarch64 Linux' linux-aarch64 qemu-aarch64-static
emulated '32-bit ARM Linux' linux-arm qemu-arm-static
emulated 's390x Linux, big endian' linux-s390x qemu-s390x-static
emulated 'x86-64 Linux with musl' linux-x86-64 env
released linux-x86-64 env
released linux-aarch64 qemu-aarch64-static
windows() { # both programs, linked, and their promises where wine is
    local name='Windows, mingw-w64' build=build/portable/windows
    has x86_64-w64-mingw32-gcc || { verdict "$name" skip 'no x86_64-w64-mingw32-gcc'; return; }
    scripts/cross.sh windows-x86-64 $build oceanxl oceanxl-lab >$build.log 2>&1 || { verdict "$name" 1 "does not build, $build.log"; return; }
    has wine || { verdict "$name" 0 'linked; no wine to run it'; return; }
    make ZLIB=0 BUILD=build/portable/stb all >$build.log 2>&1 # PNG files have other bytes with zlib
    tests/windows.sh $build build/portable/stb/oceanxl >$build.test 2>&1
    verdict "$name" $? "$(tail -n 1 $build.test), $build.test"
}
windows
compiles 'tcc' tcc -std=c99 -Ibuild/portable/include -c oceanxl.c -o build/portable/tcc.o
echo "$passed passed, $failed failed, $skipped skipped"
[ $failed = 0 ]
