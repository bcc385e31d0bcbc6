#!/bin/sh
# shaders.sh [check] - makes shaders/spirv.h of shaders/*.comp with glslc, or checks that it is what they give.
#
# The header says which sources and which glslc it was made of. The sources are compared always, the words only by the same glslc.
set -eu
cd "$(dirname "$0")/../shaders"
header=spirv.h
sources=$(cat -- *.comp *.glsl | cksum | tr ' ' '-')
version=$(glslc --version 2>/dev/null | tr '\n' ' ' | sed 's/ *$//' || true)

emit() {
    echo "/* spirv.h - the shaders of this folder as SPIR-V, for Vulkan 1.0. Made by tools/shaders.sh: do not edit."
    echo " * sources: $sources"
    echo " * glslc: $version */"
    for shader in *.comp; do
        name=$(echo "${shader%.comp}" | tr a-z A-Z)
        glslc --target-env=vulkan1.0 -O -I. "$shader" -o "$work"
        echo "static const uint32_t SPIRV_$name[] = {"
        od -An -v -tu4 "$work" | sed 's/^ *//; s/  */,/g; s/$/,/'
        echo "};"
    done
}

if [ "${1:-}" = check ]; then
    grep -q "sources: $sources\$" "$header" || {
        echo "shaders: $header was made of other sources. fix: make shaders" >&2
        exit 1
    }
    if ! grep -qF "glslc: $version */" "$header"; then
        echo "shaders: the sources are those of $header; skipped: it was made by another glslc than '${version:-none here}'"
        exit 0
    fi
fi
work=$(mktemp)
trap 'rm -f "$work" "$work.h"' EXIT
emit >"$work.h"
if [ "${1:-}" = check ]; then
    cmp "$work.h" "$header" || { echo "shaders: $header is not what glslc makes. fix: make shaders" >&2; exit 1; }
    echo "shaders: $header is current"
else
    cat "$work.h" >"$header"
fi
