#!/bin/bash
# Runs a study with Debian's Slurm (munged, slurmctld, slurmd) on one node in a network namespace, as a job array of four tasks that is cancelled in the middle
# and submitted again. The result must be the same, byte for byte, as without Slurm. usage: test_slurm.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
PATH=$PATH:/usr/sbin:/sbin
for program in munged slurmctld slurmd sbatch; do
    command -v $program >/dev/null || { echo "skipped: no $program: apt install slurm-wlm munge"; exit 77; }
done
/usr/bin/python3 -c 'import yaml' || { echo "skipped: apt install python3-yaml"; exit 77; }
. "$(dirname "$0")/../shared/in_namespace.sh"
cd "$work"
fail() { echo "FAILED: $*" >&2; tail -n 20 ./*.log study/slurm-*.txt 2>/dev/null >&2 || true; exit 1; }

# Waits for up to a minute until a command succeeds.
await() {
    local attempt
    for attempt in {1..600}; do "$@" >/dev/null 2>&1 && return; sleep 0.1; done
    return 1
}

node=$(hostname -s) user=$(id -un)
ip address add 192.0.2.1/32 dev lo # Slurm needs a non-loopback address before it listens
mkdir state spool
chmod 755 "$work" # munged refuses a socket that others cannot reach
head -c 128 /dev/urandom >munge.key
chmod 600 munge.key
munged --foreground --force --key-file="$work/munge.key" --socket="$work/munge.socket" --pid-file="$work/munged.pid" --seed-file="$work/munge.seed" \
    --log-file="$work/munged.log" --num-threads=1 2>munged.err.log &
await munge --socket="$work/munge.socket" --no-input || { echo "skipped: munged does not run here: $(cat munged.log munged.err.log)"; exit 77; }

cat >slurm.conf <<END
ClusterName=test
SlurmctldHost=$node(127.0.0.1)
AuthType=auth/munge
AuthInfo=socket=$work/munge.socket
CredType=cred/munge
SlurmUser=$user
SlurmdUser=$user
SlurmctldPort=6817
SlurmdPort=6818
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=batch_sched_delay=0,sched_min_interval=100000
MpiDefault=none
MailProg=/bin/true
SwitchType=switch/none
ReturnToService=2
KillWait=1
CompleteWait=0
NodeName=$node NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN
PartitionName=all Nodes=$node Default=YES MaxTime=INFINITE State=UP
END
export SLURM_CONF=$work/slurm.conf
slurmctld -D -i >slurmctld.log 2>&1 &
slurmd -D >slurmd.log 2>&1 &
is_idle() { [ "$(timeout 1 sinfo --noheader --format=%T)" = idle ]; }
await is_idle || { echo "skipped: Slurm does not run here: $(grep -h error ./*.log | head -n 3)"; exit 77; }

export PYTHONPATH=$build/clients/python TROCAR_LIBRARY=$build/core/libtrocar.so PYTHONDONTWRITEBYTECODE=1
cat >study.yaml <<END
scene: $(realpath --relative-to=. "$source/meshes/figure8.yaml")
motion: {script: insert, speed: 4}
samples: {method: random, count: 12, seed: 1}
parameters:
  regions[prostate].friction.kinetic: {uniform: [5, 13]}
  motion.x: {uniform: [-3e-3, 3e-3]}
record: [peak_force, work, {tip: {at: 0.3}}]
END
study() { /usr/bin/python3 -m trocar.studies.study "$@"; }
study run study.yaml --out local --workers 2 --quiet >/dev/null || fail "without Slurm"

# Prints the total number of rows in all tasks' files, without the header rows.
rows() { cat study/rows-*.csv 2>/dev/null | grep -vc '^run,' || true; }
some_rows() { [ "$(rows)" -ge 3 ]; }
submitted=$(study run study.yaml --out study --engine slurm --tasks 4) || fail "submission"
job=$(sed -n 's/.* as job \([0-9]*\);.*/\1/p' <<<"$submitted")
await some_rows || fail "no rows"
scancel --signal=KILL --full "$job" # the running tasks, children included
scancel "$job"                      # and those that wait
is_over() { [ -z "$(timeout 1 squeue --noheader)" ]; }
await is_over || fail "the job is not cancelled"
before=$(rows)
[ "$before" -lt 12 ] || fail "the job was over before it was cancelled"
! study collect study.yaml --out study 2>collect.log || fail "an incomplete study is collected"
grep -q "$before of 12 runs are done" collect.log || fail "$(cat collect.log)"
printf '5,ok,torn' >>study/rows-2-of-4.csv

study run study.yaml --out study --engine slurm --tasks 4 >/dev/null || fail "submission again" # not --wait: sbatch then polls only now and then
await is_over || fail "the job is not over"
study collect study.yaml --out study >/dev/null || fail "collect"
grep -q 'incomplete last line' study/slurm-2.txt || fail "the torn line is not reported"
cmp study/result.csv local/result.csv || fail "the results differ"
[ "$(rows)" -eq 12 ] || fail "$(rows) rows: some runs were done twice"

# Submits, waits and collects in one command, for a study that lacks only two runs.
sed -i 2,3d study/rows-3-of-4.csv
rm study/result.csv
study run study.yaml --out study --engine slurm --tasks 4 --wait >wait.log || fail "--wait: $(cat wait.log)"
cmp study/result.csv local/result.csv || fail "the results differ after --wait"
[ "$(rows)" -eq 12 ] || fail "$(rows) rows: --wait did runs twice"
echo "passed: $before runs before the cancellation"
