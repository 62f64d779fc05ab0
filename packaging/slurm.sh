#!/usr/bin/env bash
# A job of 64 ranks for Slurm. It goes on from its checkpoint until the script comes to its end:
#   sbatch packaging/slurm.sh packaging/restart.py
#   DOLFINMPM_SIF=dolfinmpm.sif sbatch packaging/slurm.sh packaging/restart.py      in an image
# The script loads the file $CHECKPOINT where there is one, and saves it after each step, as
# packaging/restart.py does. The number of ranks may change from start to start.
#SBATCH --job-name=dolfinmpm
#SBATCH --ntasks=64
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=2G
#SBATCH --time=08:00:00
#SBATCH --signal=B:USR1@600
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=%x-%j.out
set -euo pipefail
if (($# == 0)); then echo "usage: sbatch $0 SCRIPT [ARGUMENTS]" >&2; exit 2; fi
export CHECKPOINT=${CHECKPOINT:-$PWD/checkpoint.npz}
export OMP_NUM_THREADS=1 # one thread per rank
python=(python3)
if [[ -n ${DOLFINMPM_SIF-} ]]; then python=(apptainer exec "$DOLFINMPM_SIF" python3); fi

# 600 s before the end of its time the job goes back to the queue, if it has saved a step since its
# start. One step has to take less than that.
start=$(mktemp)
# shellcheck disable=SC2317 # the trap calls it
again() {
    if [[ $CHECKPOINT -nt $start ]]; then
        echo "back to the queue, with $CHECKPOINT"
        scontrol requeue "$SLURM_JOB_ID"
    else
        echo "no step was saved since the start: give the job more time" >&2
    fi
}
trap again USR1

# Open MPI takes pmix. MPICH takes pmi2; `srun --mpi=list` tells what there is.
srun --mpi="${DOLFINMPM_PMI:-pmix}" "${python[@]}" "$@" &
job=$!
code=0
wait "$job" || code=$?
while kill -0 "$job" 2>/dev/null; do # the signal has ended the wait, not the job
    code=0
    wait "$job" || code=$?
done
rm -f "$start"
exit "$code"
