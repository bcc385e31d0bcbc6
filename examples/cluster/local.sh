#!/bin/sh
# local.sh - train a survey by blocks on one machine, several at a time.
#
#     examples/cluster/local.sh SCENE OUT [options of oceanxl train]
#     JOBS=4 THREADS=8 examples/cluster/local.sh survey out --preset standard
#
# JOBS blocks at once (2), each with THREADS threads (its share of the cores): mind the memory, which --ram limits for
# a block. Run it again after a Ctrl-C or a power cut: finished blocks stand, the others go on from their checkpoints.
set -eu
[ $# -ge 2 ] || { sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2; }
scene=$1 out=$2
shift 2
oceanxl=${OCEANXL:-oceanxl}
jobs=${JOBS:-2}
threads=${THREADS:-$(($(getconf _NPROCESSORS_ONLN) / jobs))}
[ "$threads" -ge 1 ] || threads=1

blocks=$("$oceanxl" check "$scene" "$@" | sed -n 's/^blocks *\([0-9]*\),.*/\1/p')
[ "$blocks" ] || exit 1

# xargs fails when one of them does, and set -e then leaves before the merged model
seq 0 $((blocks - 1)) | xargs -P "$jobs" -I '{}' "$oceanxl" train "$scene" -o "$out" --block '{}' --threads "$threads" --quiet "$@"
"$oceanxl" train "$scene" -o "$out" "$@"
