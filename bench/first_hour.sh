#!/usr/bin/env bash
# first_hour.sh [DEVICE] - what to run first on a machine with a GPU: limits, tests, times, two trainings; a report in Markdown.
#
#     bench/first_hour.sh > report.md          at most 10 minutes; needs what make VULKAN=1 needs, and the GPU's driver
#     SMALL=1 bench/first_hour.sh              a rehearsal on a device made of the CPU (lavapipe): the same steps at sizes it can do
#
# Each step has its share of the time and is stopped at its end: a stopped step is reported, the others continue. Exit code: 1 when a
# test fails or two trainings differ.
set -u
cd "$(dirname "$0")/.." || exit 1
device=${1:--1}
build=${BUILD:-build/first_hour}
log=$build/first_hour.log
failed=0
if [ -n "${SMALL:-}" ]; then
    sizes='2000:160:90 8000:320:180' variants=8000:320:180 share=240 iterations=60 views=8 building=900
else
    sizes='30000:640:360 300000:1280:720 1000000:1920:1080 4000000:3840:2160' variants=1000000:1920:1080 share=60 iterations=600 views=24 building=240
fi

command -v timeout >/dev/null || { echo 'needs the command timeout; on macOS: brew install coreutils, and its gnubin folder in PATH'; exit 1; }

run() { # SECONDS COMMAND...
    local limit=$1 code
    shift
    timeout --kill-after=5 "$limit" "$@" >>"$log" 2>&1
    code=$?
    [ $code != 124 ] && [ $code != 137 ] || echo "stopped after $limit s: $*"
    return $code
}

verdict() { # NAME CODE
    if [ "$2" = 0 ]; then echo "- $1: ok"; else echo "- $1: FAILED ($2), see $log"; failed=1; fi
}

# One line of the table of passes: what bench/device.c prints, in milliseconds. OXL_BENCH_PARTS=1: with lamp, medium, dropout, depth loss.
times() { # GAUSSIANS:WIDTH:HEIGHT
    local g w h out
    IFS=: read -r g w h <<<"$1"
    out=$(timeout --kill-after=5 $share "$build/bench_device" "$g" "$w" "$h" "$device" 2>&1) || { echo "| $g | $w x $h | stopped or failed: $(tail -n 1 <<<"$out") |"; return; }
    echo "$out" >>"$log"
    awk -v g="$g" -v size="$w x $h" '
        /pairs,/ { for (i = 1; i <= NF; i++) if ($i == "(tile,") pairs = $(i - 1) }
        match($0, /^  [a-z][a-zA-Z ,+]*[a-zA-Z] +[0-9.]+ ms/) {
            line = substr($0, RSTART, RLENGTH); sub(/ ms$/, "", line); ms = line; sub(/.* /, "", ms); sub(/ +[0-9.]+$/, "", line); sub(/^ +/, "", line)
            t[line] = ms
        }
        / a step:/ { waits = $3; for (i = 1; i <= NF; i++) if ($i ~ /^dispatches/) dispatches = $(i - 1) }
        END {
            sort = t["scan"] + t["compact"] + t["sort, count"] + t["sort, scatter"] + t["footprint"] + t["ranges"]
            parts = t["lamp"] + t["imaging, pixels"] + t["imaging, total"] + t["depth loss"]
            loss = t["loss forward"] + t["loss total"] + t["loss backward"] + t["unpack"]
            printf "| %s | %s | %s | %.2f | %.2f | %.2f | %.2f | %.2f | %.2f | %.2f | %.2f | %s | %s |\n", g, size, pairs, t["project"], sort,
                t["raster"], loss, t["raster backward"], t["backward + Adam"], parts, t["step"], waits, dispatches
        }' <<<"$out"
}

mkdir -p "$build"
: >"$log"
echo "# First hour on a GPU"
echo
echo "OceanXL $(sed -n 's/^#define OXL_VERSION "\(.*\)"/\1/p' oceanxl.h), $(git rev-parse --short HEAD 2>/dev/null || echo 'no git'), $(uname -srm)."
echo
run $building make -j"$(getconf _NPROCESSORS_ONLN)" VULKAN=1 BUILD="$build" CFLAGS="${CFLAGS:--O2 -g}" "$build/oceanxl" "$build/oceanxl-lab" "$build/bench_device" "$build/test" || { echo "the build failed, see $log"; exit 1; }
echo '## Devices'
echo
echo '```'
"$build/oceanxl" info --devices
command -v vulkaninfo >/dev/null && vulkaninfo 2>/dev/null | grep -E 'deviceName|driverInfo|subgroupSize |maxComputeSharedMemorySize|maxStorageBufferRange|maxMemoryAllocationCount|timestampPeriod|size  *= .*GiB' | sort -u
echo '```'
echo
echo '## Tests'
echo
export OXL_TEST_DEVICE=$device
OXL_VULKAN_VALIDATE=0 run $((2 * share)) "$build/test" vulkan
verdict 'tests, without validation' $?
run $((2 * share)) "$build/test" vulkan
code=$?
verdict "tests, with validation ($([ -e /usr/share/vulkan/explicit_layer.d/VkLayer_khronos_validation.json ] && echo 'the layer is installed' || echo 'the layer is NOT installed'))" $code
echo
echo '## Times'
echo
echo "Milliseconds of the device's clock; step: the host's, with its waits. $("$build/bench_device" 1000 64 64 "$device" 2>/dev/null | head -n 1)"
echo
echo '| Gaussians | image | pairs | project | sort | raster | loss | raster backward | backward + Adam | parts | step | waits | dispatches |'
echo '|---|---|---|---|---|---|---|---|---|---|---|---|---|'
for size in $sizes; do times "$size"; done
echo "The last with lamp, medium, dropout, the loss in front of points (OXL_BENCH_PARTS=1):" >>"$log"
export OXL_BENCH_PARTS=1
times "$variants"
unset OXL_BENCH_PARTS
echo
echo 'Waits: of the host while the device has nothing else to do. Parts: passes of lamp, medium, the loss in front of points, which the last line has.'
echo
echo '## Training'
echo
run 60 "$build/oceanxl" synth -o "$build/survey" --views $views --size 320x240 --points 4000 --quiet
run 60 "$build/oceanxl" synth -o "$build/deep" --views $views --size 320x240 --points 4000 --water II --lamp 1.5 --backscatter 0.08 --stereo 0.3 --quiet
# Trains a survey with a backend.
train() { # NAME SURVEY BACKEND WORDS [OPTION...]
    local name=$1 survey=$2 backend=$3 words=$4 begun=$SECONDS code
    shift 4
    [ "$backend" = cpu ] || [ "$device" = -1 ] || set -- "$@" --device "$device"
    rm -rf "${build:?}/$name"
    run $share "$build/oceanxl" train "$build/$survey" -o "$build/$name" --iterations $iterations --seed 1 --quiet --backend "$backend" "$@"
    code=$?
    verdict "$name, $words: $((SECONDS - begun)) s, PSNR $(sed -n 's/^ *"psnr": \([0-9.]*\),$/\1/p' "$build/$name/metrics.json" 2>/dev/null) dB" $code
}

same() { # WORDS NAME NAME
    cmp -s "$build/$2/scene.ply" "$build/$3/scene.ply"
    verdict "$1 give the same bytes" $?
}

train cpu survey cpu "$iterations iterations"
train device-1 survey vulkan "$iterations iterations"
train device-2 survey vulkan "$iterations iterations"
same 'two trainings on the device' device-1 device-2
train deep-cpu deep cpu 'lamp and medium'
train deep-1 deep vulkan 'lamp and medium'
train deep-2 deep vulkan 'lamp and medium'
same 'two trainings with lamp and medium' deep-1 deep-2
for backend in cpu vulkan; do
    train "blocks-$backend" deep $backend 'two blocks in front of each other, dropout' --blocks 2 --dropout 0.1
done
exit $failed
