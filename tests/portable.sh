#!/usr/bin/env bash
# tests/portable.sh - other machines, C libraries and compilers: builds, and where something can run it, tests. Tools that are not
# installed are said and skipped; nothing that was skipped counts as passed.
#
# Debian: qemu-user, gcc-aarch64-linux-gnu, gcc-arm-linux-gnueabihf, gcc-s390x-linux-gnu (with their libc6-dev-*-cross), musl-tools, tcc,
# gcc-mingw-w64-x86-64. WORDS="..." names the tests that run under the emulator.
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

# NAME COMPILER EMULATOR [make arguments]: the library's tests, serial, on another machine.
emulated() {
    local name=$1 cc=$2 emulator=$3 build=build/portable/$2 code
    has "$cc" && has "${emulator%% *}" || { verdict "$name" skip "no $cc or ${emulator%% *}"; return; }
    mkdir -p "$build"
    make -j1 CC="$cc" OPENMP=0 STB=$stb BUILD="$build" CFLAGS='-O0 -static' WERROR= "$build/test" >"$build.log" 2>&1 ||
        { verdict "$name" 1 "does not build, $build.log"; return; }
    # shellcheck disable=SC2086
    $emulator "$build/test" $words >"$build.test" 2>&1
    code=$?
    verdict "$name" $code "$(tail -n 1 "$build.test") ($words)"
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
emulated 'aarch64 Linux' aarch64-linux-gnu-gcc 'qemu-aarch64'
emulated '32-bit ARM Linux' arm-linux-gnueabihf-gcc 'qemu-arm'
emulated 's390x Linux, big endian' s390x-linux-gnu-gcc 'qemu-s390x'
emulated 'x86-64 Linux with musl' musl-gcc env
windows() { # the program, linked, and run where wine is
    local name='Windows, mingw-w64' build=build/portable/mingw run
    has x86_64-w64-mingw32-gcc || { verdict "$name" skip 'no x86_64-w64-mingw32-gcc'; return; }
    make -j1 CC=x86_64-w64-mingw32-gcc OPENMP=0 STB=$stb BUILD=$build WERROR= CFLAGS='-O1 -static -DOXL_NO_SIMD' $build/oceanxl $build/oceanxl-lab >$build.log 2>&1 ||
        { verdict "$name" 1 "does not build, $build.log"; return; }
    has wine || { verdict "$name" 0 'linked; no wine to run it'; return; }
    rm -rf $build/survey $build/out
    run="env WINEDEBUG=-all wine $build/oceanxl.exe"
    env WINEDEBUG=-all wine $build/oceanxl-lab.exe synth -o $build/survey --views 10 --size 96x64 --points 800 --quiet >>$build.log 2>&1 &&
        $run train $build/survey -o $build/out --iterations 20 --quiet >>$build.log 2>&1 && $run eval $build/out $build/survey >>$build.log 2>&1
    verdict "$name" $? 'linked; synth, train and eval under wine'
}
windows
compiles 'tcc' tcc -std=c99 -Ibuild/portable/include -c oceanxl.c -o build/portable/tcc.o
echo "$passed passed, $failed failed, $skipped skipped"
[ $failed = 0 ]
