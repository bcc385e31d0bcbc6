#!/bin/sh
# parts.sh - where the parts of training are named in code outside their own files and rows: identifiers with the part's name between
# underscores (renderer_set_medium, options->lamp), comments and texts left out.
#
# A line a part: how often each layer of KERNELS below names it, then the exceptions as file:count. Fails when src/train names a part by
# more than the words in TRAIN, or reads an option of one.
set -eu
cd "$(dirname "$0")/.."

# Layers that may name parts, and why.
kernels='src/render|kernels: a branch for lobes, dropout, medium, lamp, gains, with one entry each (render.h)
backends/vulkan|the same kernels on a device
src/survey|the formation of images as imaging.txt and tracks state it
src/model|what a row of a model may hold: second lobes, SH bands
src/formats|files hold second lobes and SH bands
src/large/merge.c|rows of models are merged as they are
oceanxl.h|fields of the options and of results
oceanxl_job.h|fields of the options and of results'
# Words that src/train may use: of the shape of a model's rows, of the entries of kernels, and of what the model for viewers leaves out.
train='sh_degree lobes antialias OXL_LOBE MODEL_LOBE_RATE_OPACITY MODEL_LOBE_RATE_SCALE model_set_lobes model_drop_lobes
    lamps medium medium_bake medium_make_standard renderer_set_medium exposure'

words() { # of identifiers, by part; the option keep of prune is left out, a common word
    case $1 in
        lobes) echo 'lobes|lobe|dog' ;;
        prune) echo 'prune|pruned|pruning' ;;
        lamp) echo 'lamp|lamps' ;;
        *) echo "$1" ;;
    esac
}

files=$(ls main.c oceanxl.h oceanxl_job.h src/*/*.[ch] cli/*.[ch] tools/*.[ch] backends/vulkan/*.[ch] | grep -v '^src/parts/')
tokens=$(mktemp)
trap 'rm -f "$tokens"' EXIT
# A line each: file, line, identifier; OPTION_ before a member of the options.
awk '
    FNR == 1 { inside = 0 }
    {
        line = $0
        code = ""
        while (line != "") {
            if (inside) {
                at = index(line, "*/")
                if (!at) { line = ""; break }
                line = substr(line, at + 2)
                inside = 0
            } else if (match(line, /"([^"\\]|\\.)*"|\047(\\.|[^\\])\047|\/\*|\/\//)) {
                word = substr(line, RSTART, RLENGTH)
                code = code substr(line, 1, RSTART - 1) " "
                line = word == "//" ? "" : substr(line, RSTART + RLENGTH)
                inside = word == "/*"
            } else {
                code = code line
                line = ""
            }
        }
        if (code ~ /^#include/) next
        gsub(/options->|options\.|[^A-Za-z0-9_]o->/, " OPTION_")
        while (match(code, /[A-Za-z_][A-Za-z0-9_]*/)) {
            print FILENAME, FNR, substr(code, RSTART, RLENGTH)
            code = substr(code, RSTART + RLENGTH)
        }
    }' $files >"$tokens"

wrong=0
for part in $(sed -n 's/^ *ROW(\([a-z_]*\)).*/\1/p' src/parts/parts.h); do
    KERNELS=$kernels TRAIN=$train awk -v part="$part" -v words="$(words "$part")" '
        BEGIN {
            n = split(ENVIRON["KERNELS"], row, "\n")
            for (i = 1; i <= n; i++) { split(row[i], column, "|"); layer[column[1]] = 1; order[++layers] = column[1] }
            n = split(ENVIRON["TRAIN"], word, /[ \n]+/)
            for (i = 1; i <= n; i++) general[word[i]] = 1
        }
        tolower($3) ~ "(^|_)(" words ")(_|$)" {
            folder = $1
            if (folder ~ "/") sub("/[^/]*$", "", folder)
            if ($1 in layer) count[$1]++
            else if (folder in layer) count[folder]++
            else if (folder == "src/train" && $3 in general) count[folder " (words of kernels and models)"]++
            else {
                if (folder == "src/train") {
                    printf "parts: %s:%s names %s: %s; wanted: a hook of src/train/part.h\n", $1, $2, part, $3 > "/dev/stderr"
                    wrong = 1
                }
                if (!($1 in odd)) list[++odds] = $1
                odd[$1]++
            }
        }
        END {
            printf "%s:", part
            order[++layers] = "src/train (words of kernels and models)"
            for (i = 1; i <= layers; i++) if (order[i] in count) printf " %s %d,", order[i], count[order[i]]
            printf " exceptions:"
            for (i = 1; i <= odds; i++) printf " %s:%d", list[i], odd[list[i]]
            print odds ? "" : " none"
            exit wrong
        }' "$tokens" || wrong=1
done
echo "$kernels" | awk -F'|' '{ printf "allowed: %s: %s\n", $1, $2 }'
[ $wrong = 0 ] && echo 'parts: 0 parts of training named by src/train'
exit $wrong
