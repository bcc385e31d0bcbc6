#!/bin/sh
# python.sh [WORD...] - python/oceanxl.py and its examples against the library of BUILD (build); WORDs name tests. Skipped without numpy.
set -eu
cd "$(dirname "$0")/.."
build=$(realpath "${BUILD:-build}")
python=python3
$python -c 'import numpy' 2>/dev/null || python=/usr/bin/python3
$python -c 'import numpy' 2>/dev/null || { echo 'skipped: python3 has no numpy (Debian: python3-numpy)'; exit 0; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$build/oceanxl" synth -o "$work/survey" --views 12 --size 96x64 --points 800 --quiet
"$build/oceanxl" synth -o "$work/other" --views 8 --size 96x64 --points 400 --seed 2 --quiet
if [ -z "${BUILD:-}" ] && [ $# = 0 ] && $python -c 'import setuptools, pip' 2>/dev/null; then # as a user installs it, without network
    $python -m pip install --quiet --no-index --no-deps --no-build-isolation --root-user-action=ignore --target "$work/site" .
    (cd "$work" && PYTHONPATH=$work/site $python -c 'import oceanxl as oxl; assert "site" in oxl.__file__; print("installed:", len(oxl.load("survey").views), "views")')
fi
OXL_LIBRARY=$build/liboceanxl.so OMP_NUM_THREADS=${OMP_NUM_THREADS:-1} $python tests/python.py "$work" "$@"
