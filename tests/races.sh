#!/usr/bin/env bash
# tests/races.sh [WORD...] - the library's tests, or those whose names hold a word, with three threads under ThreadSanitizer.
#
# gcc's libgomp is not built for it: this takes clang, LLVM's libomp, and archer, libomp's tool that informs ThreadSanitizer where OpenMP
# synchronises (Debian: clang, libomp-dev has both). A loop with a race and the same loop without one prove first that it sees and that it
# does not cry wolf. Without vectors of ours (OXL_NO_SIMD): accesses of more than 16 bytes go unseen.
set -u
cd "$(dirname "$0")/.." || exit 1
work=build/races
mkdir -p "$work"
export OMP_NUM_THREADS=3 OMP_WAIT_POLICY=passive TSAN_OPTIONS=ignore_noninstrumented_modules=1

probe() { # NAME CLAUSE: prints the number of races detected in a sum over a parallel loop
    echo "int main(void) { int sum = 0, x[999];
    #pragma omp parallel for
    for (int i = 0; i < 999; i++) x[i] = i;
    #pragma omp parallel for $2
    for (int i = 0; i < 999; i++) sum += x[998 - i];
    return sum == 0; }" | clang -O1 -g -fopenmp -fsanitize=thread -x c - -o "$work/$1" || return 1
    "$work/$1" 2>&1 | grep -c 'WARNING: ThreadSanitizer: data race'
}

if ! command -v clang >/dev/null; then echo 'races: no clang (Debian: clang, libomp-dev)'; exit 1; fi
if [ "$(probe clean 'reduction(+ : sum)')" != 0 ] || [ "$(probe race '')" -lt 1 ]; then
    echo 'races: ThreadSanitizer does not see what OpenMP does; it takes libomp with archer (Debian: libomp-dev)'
    exit 1
fi
echo 'a planted race is seen, and none where there is none'
make CC=clang BUILD="$work" CFLAGS='-O1 -g -DOXL_NO_SIMD -fsanitize=thread' "$work/test" >"$work/build.log" 2>&1 || { tail -n 5 "$work/build.log"; exit 1; }
"$work/test" "$@" >"$work/log" 2>&1
code=$?
grep -A 12 -e 'WARNING: ThreadSanitizer' "$work/log" | head -n 60
grep '^FAIL' "$work/log"
echo "$(grep -c 'WARNING: ThreadSanitizer' "$work/log") races; $(tail -n 1 "$work/log")"
exit $code
