#!/bin/sh
# slurm.sh - train a survey by blocks on a Slurm cluster: a job array with a task for each block, and the merged model when all have ended well.
#
#     examples/cluster/slurm.sh SCENE OUT [options of oceanxl train]
#     CPUS=16 MEM=16G TIME=8:00:00 examples/cluster/slurm.sh survey out --preset paper
#
# CPUS, MEM and TIME are for one block (2, Slurm's own, Slurm's own); account and partition go by SBATCH_ACCOUNT and SBATCH_PARTITION.
# SCENE and OUT must lie where every node sees them. Give --blocks or --ram: without them the first node's free memory decides on blocks. Prints the ids of both jobs.
#
# A task may be requeued or killed at any time: the program goes on from its last checkpoint (a minute old at most) when it is run
# again. Shortly before TIME is over the task stops in good order and puts itself into the queue again. Running this script again
# submits all of it again; what is done already is seen to be done.
set -eu

# ------------------------------------------------------------------------------------------------ inside of a task

task() { # the program's arguments
    "$OCEANXL" "$@" --threads "${SLURM_CPUS_PER_TASK:-1}" --quiet &
    program=$!
    again=
    trap 'again=1; kill -TERM $program' USR1 # Slurm's word that TIME is nearly over
    rc=0
    wait $program || rc=$?
    if [ -n "$again" ]; then # the trap ended the first wait, not the program
        rc=0
        wait $program || rc=$?
    fi
    if [ -n "$again" ] && [ $rc = 130 ]; then scontrol requeue "$SLURM_JOB_ID"; fi
    exit $rc
}

case ${1:-} in
--block)
    scene=$2 out=$3
    shift 3
    task train "$scene" -o "$out" --block "$SLURM_ARRAY_TASK_ID" "$@"
    ;;
--merged)
    scene=$2 out=$3
    shift 3
    task train "$scene" -o "$out" "$@"
    ;;
esac

# ------------------------------------------------------------------------------------------------ on the front node

[ $# -ge 2 ] || { sed -n '2,14s/^# \{0,1\}//p' "$0" >&2; exit 2; }
scene=$1 out=$2
shift 2
OCEANXL=${OCEANXL:-$(command -v oceanxl)} || { echo 'slurm.sh: oceanxl is not in the PATH. fix: OCEANXL=/where/it/is/oceanxl' >&2; exit 2; }
export OCEANXL

blocks=$("$OCEANXL" check "$scene" "$@" | sed -n 's/^blocks *\([0-9]*\),.*/\1/p')
[ "$blocks" ] || exit 1
mkdir -p "$out"
log="$out/slurm-%A_%a.log"
# --signal=B: the script is told, not the program
common="--parsable --export=ALL --open-mode=append --requeue --signal=B:USR1@120 --cpus-per-task=${CPUS:-2} ${MEM:+--mem=$MEM} ${TIME:+--time=$TIME}"

# shellcheck disable=SC2086 # the common options are words
array=$(sbatch $common --job-name=oceanxl-block --output="$log" --array=0-$((blocks - 1)) \
    "$0" --block "$scene" "$out" "$@")
echo "array $array: $blocks blocks"
# shellcheck disable=SC2086
merged=$(sbatch $common --job-name=oceanxl-merged --output="$out/slurm-%j-merged.log" --dependency="afterok:$array" \
    --kill-on-invalid-dep=yes "$0" --merged "$scene" "$out" "$@")
echo "merged model $merged"
