#!/bin/sh
# shaders.sh [check] - makes generated/spirv.h (words) and generated/bindings.h (sizes) of shaders/*.comp with glslc, or checks that
# they are what the shaders give.
#
# The first header says which sources and which glslc it was made of. The sources are compared always, the words only by the same glslc.
set -eu
cd "$(dirname "$0")/shaders"
header=../generated/spirv.h
sources=$(cat -- *.comp *.glsl | cksum | tr ' ' '-')
version=$(glslc --version 2>/dev/null | tr '\n' ' ' | sed 's/ *$//' || true)

# How many storage buffers a shader binds and how many bytes it is pushed, read from its words: the C code takes both from here, so that the
# host and the shader cannot disagree; and the bytes of its shared memory, at most: as std430 lays it out, whatever the order. What is pushed are numbers of 32 bits; the largest offset tells how many.
tell_size() { # NAME WORDS
    od -An -v -tu4 -w4 "$2" | awk -v name="$1" '
    { word[NR - 1] = $1 }
    END {
        for (i = 5; i < NR; i += int(word[i] / 65536)) {
            code = word[i] % 65536
            if (code == 71 && word[i + 2] == 33 && word[i + 3] >= bindings) bindings = word[i + 3] + 1 # OpDecorate Binding
            if (code == 72 && word[i + 3] == 35 && word[i + 4] >= size[word[i + 1]]) size[word[i + 1]] = word[i + 4] + 4 # Offset
            if ((code == 21 || code == 22) && word[i + 2] == 32) number[word[i + 1]] = 1 # OpTypeInt, OpTypeFloat
            if (code == 30) for (k = 2; k < int(word[i] / 65536); k++) others[word[i + 1]] += !(word[i + k] in number) # OpTypeStruct
            if (code == 21 || code == 22) bytes[word[i + 1]] = word[i + 2] / 8 # of shared memory: numbers,
            if (code == 23) bytes[word[i + 1]] = (word[i + 3] == 3 ? 4 : word[i + 3]) * bytes[word[i + 2]] # vectors
            if (code == 43) value[word[i + 2]] = word[i + 3] # OpConstant
            if (code == 28) bytes[word[i + 1]] = bytes[word[i + 2]] * value[word[i + 3]] # arrays
            if (code == 28 && !(word[i + 3] in value)) unsized[word[i + 1]] = 1 # by a specialization constant: see raster.glsl
            if (code == 32 && word[i + 2] == 4) { points[word[i + 1]] = bytes[word[i + 3]]; wrong += unsized[word[i + 3]] }
            if (code == 59 && word[i + 3] == 4) shared += 16 * int((points[word[i + 1]] + 15) / 16) # OpVariable Workgroup
            if (code == 32 && word[i + 2] == 9 && word[i + 3] in others) push = word[i + 3] # OpTypePointer PushConstant
        }
        if (wrong) { print "shaders: " name " has a shared array sized by a specialization constant" > "/dev/stderr"; exit 1 }
        if (others[push] > 0 || bindings == 0 || size[push] == 0) {
            print "shaders: " name " pushes what is no number of 32 bits, or binds or pushes nothing" > "/dev/stderr"
            exit 1
        }
        print "enum { SPIRV_" name "_BINDINGS = " bindings ", SPIRV_" name "_PUSH = " size[push] ", SPIRV_" name "_SHARED = " shared + 0 " };"
    }'
}

emit() {
    echo "/* spirv.h - the shaders of backends/vulkan/shaders as SPIR-V, for Vulkan 1.0. Made by backends/vulkan/shaders.sh: do not edit."
    echo " * sources: $sources"
    echo " * glslc: $version */"
    for shader in *.comp; do
        base=$(echo "${shader%.comp}" | tr a-z A-Z)
        case $base in
        RASTER | RASTER_BACKWARD) build "$base" -DLOBED=0 && build "${base}_LOBED" -DLOBED=1 ;;
        PROJECT_BACKWARD) build "$base" -DSTEP=0 && build STEP -DSTEP=1 ;;
        *) build "$base" ;;
        esac
    done
}

# build NAME [MACRO...]: $shader as SPIRV_NAME. spirv-val, where it is installed, has the last word.
build() {
    name=$1
    shift
    glslc --target-env=vulkan1.0 -O -I. "$@" "$shader" -o "$work"
    if command -v spirv-val >/dev/null; then spirv-val --target-env vulkan1.0 "$work"; fi
    # one line, so that a change of a shader is one line of a diff
    printf 'static const uint32_t SPIRV_%s[] = {%s};\n' "$name" "$(od -An -v -tu4 "$work" | sed 's/^ *//; s/  */,/g; s/$/,/' | tr -d '\n')"
    tell_size "$name" "$work" >>"$work.sizes"
}

sizes() {
    echo "/* bindings.h - of each shader: how many storage buffers it binds, how many bytes it is pushed, how many are shared. Made by backends/vulkan/shaders.sh. */"
    cat "$work.sizes"
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
trap 'rm -f "$work" "$work.h" "$work.sizes" "$work.b"' EXIT
: >"$work.sizes"
emit >"$work.h"
sizes >"$work.b"
if [ "${1:-}" = check ]; then
    cmp "$work.h" "$header" && cmp "$work.b" ../generated/bindings.h || { echo "shaders: $header is not what glslc makes. fix: make shaders" >&2; exit 1; }
    echo "shaders: $header is current"
else
    cat "$work.h" >"$header"
    cat "$work.b" >../generated/bindings.h
fi
