#!/bin/sh
# Bakes a job in parts on a Slurm cluster, one array task per part, and joins them:
#
#   export SPLATPROBE_JOB=room.json SPLATPROBE_OUTPUT=/shared/out/room
#   tasks=$(sbatch --parsable --array=1-16 bake.sh)
#   sbatch --dependency=afterok:$tasks --export=ALL,SPLATPROBE_PARTS=16 merge.sh
#
# A task that is preempted goes on where it was when Slurm runs it again (--requeue).
#SBATCH --job-name=splatprobe
#SBATCH --requeue
#SBATCH --open-mode=append
set -eu

exec "${SPLATPROBE:-splatprobe}" bake "$SPLATPROBE_JOB" \
  --shard "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT" \
  --threads "${SLURM_CPUS_PER_TASK:-1}" \
  -o "$SPLATPROBE_OUTPUT.part$SLURM_ARRAY_TASK_ID" \
  --progress plain
