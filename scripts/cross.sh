#!/bin/sh
# cross.sh MACHINE BUILD TARGET... - makes BUILD/TARGET for another machine, linked statically. CFLAGS, OPENMP and LDFLAGS are make's.
#
# Debian: musl-tools; gcc-aarch64-linux-gnu (glibc: Debian has no cross compiler with musl); gcc-mingw-w64-x86-64.
set -eu
machine=$1 build=$2 openmp=
shift 2
case $machine in
# libgomp.a is built for glibc: two names that musl lacks. The second is called where threads are bound to processors, which is then refused.
linux-x86-64) cc=musl-gcc openmp='-Wl,--defsym,__sysconf=sysconf,--defsym,pthread_attr_setaffinity_np=pthread_attr_setinheritsched' ;;
linux-aarch64) cc=aarch64-linux-gnu-gcc ;;
linux-arm) cc=arm-linux-gnueabihf-gcc ;;
linux-s390x) cc=s390x-linux-gnu-gcc ;;
# gcc cannot align the stack of 64-bit Windows for vectors of 32 and 64 bytes: the assembler takes moves that need no alignment.
windows-x86-64) cc='x86_64-w64-mingw32-gcc -Wa,-muse-unaligned-vector-move' openmp='-Wl,--no-insert-timestamp' ;;
*) echo "cross.sh: $machine is not known" >&2; exit 2 ;;
esac
command -v "${cc%% *}" >/dev/null || { echo "cross.sh: $machine: no ${cc%% *}" >&2; exit 77; }
for target; do set -- "$@" "$build/$target"; shift; done
exec make CC="${CCACHE:+ccache }$cc" BUILD="$build" CFLAGS="${CFLAGS--O3}" LDFLAGS="-static ${openmp} ${LDFLAGS-}" OPENMP="${OPENMP-1}" \
    STB="${STB:-/usr/include/stb}" WERROR= "$@"
