#!/usr/bin/env bash
# A cluster of this machine alone: installs and starts Slurm, bakes the demo in four parts, joins them, and checks that the
# bytes are those of a bake at once. Debian or Ubuntu, as root: pipelines/slurm/one_node.sh [SPLATPROBE]
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
splatprobe=$(realpath "${1:-target/debug/splatprobe}")
work=$(mktemp -d)

command -v slurmctld > /dev/null || {
  apt-get update -q
  DEBIAN_FRONTEND=noninteractive apt-get install -y -q slurm-wlm munge
}

# Munge knows the cluster's members by a shared key.
[ -s /etc/munge/munge.key ] || dd if=/dev/urandom of=/etc/munge/munge.key bs=1 count=1024 status=none
chown munge: /etc/munge/munge.key
chmod 400 /etc/munge/munge.key
mkdir -p /run/munge && chown munge: /run/munge
munge -n 2> /dev/null | unmunge > /dev/null 2>&1 || runuser -u munge -- munged
munge -n | unmunge > /dev/null
echo "munge: works"

mkdir -p "$work/state" "$work/spool"
host=$(hostname -s)
cat > "$work/slurm.conf" <<CONF
ClusterName=one
SlurmctldHost=$host
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
ReturnToService=2
SchedulerType=sched/backfill
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd.log
MpiDefault=none
NodeName=$host CPUs=$(nproc) State=UNKNOWN
PartitionName=all Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF="$work/slurm.conf"
stop() {
  for daemon in slurmd slurmctld; do
    if [ -s "$work/$daemon.pid" ]; then kill "$(cat "$work/$daemon.pid")" || true; fi
  done
}
trap stop EXIT
slurmctld
slurmd
for _ in $(seq 30); do
  if sinfo -h -o %T | grep -q idle; then break; fi
  sleep 1
done
sinfo

export SPLATPROBE="$splatprobe"
export SPLATPROBE_JOB="$here/../demo/demo.json"
export SPLATPROBE_OUTPUT="$work/out"
cd "$work"
tasks=$(sbatch --parsable --array=1-4 --export=ALL "$here/bake.sh")
merge=$(sbatch --parsable --dependency="afterok:$tasks" --export=ALL,SPLATPROBE_PARTS=4 "$here/merge.sh")
echo "array job $tasks, merge job $merge"
for _ in $(seq 300); do
  if [ -z "$(squeue -h)" ]; then break; fi
  sleep 1
done
cat "$work"/slurm-*.out

"$splatprobe" bake "$SPLATPROBE_JOB" -o "$work/whole" --progress none
diff -r "$work/whole" "$work/out"
echo "the parts are the whole, byte for byte"
