#!/bin/bash
# Runs the clients as a user would: bad input, the files of trocar-replay, the balance of forces in its exports, and a simulated hand on the needle.
# usage: test_clients.sh PROGRAMS_DIR SOURCE_DIR CASE
set -euo pipefail
programs=$1 source=$2    # absolute
scene=$source/meshes/figure8.yaml
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }

# Checks that the command exits with status 2 and a message that contains this text, leaving no files behind.
refuses() {
    local text=$1 status=0
    shift
    "$@" >stdout 2>stderr || status=$?
    [ "$status" -eq 2 ] || fail "status $status, not 2: $*"
    grep -qF -- "$text" stderr || fail "no '$text' in: $(cat stderr)"
    rm -f stdout stderr
    [ -z "$(find . -newer marker -type f)" ] || fail "left behind by '$*': $(find . -newer marker -type f)"
}

bad_input() {
    local device=$programs/trocar-device replay=$programs/trocar-replay bench=$programs/trocar-bench parts=$programs/../tests/benchmarks/bench_parts
    "$device" --script insert --write-log poses.log
    head -c 1000 poses.log >cut.log
    "$device" --script hold --duration 3.1 --write-log longer.log
    "$replay" --scene "$scene" --poses longer.log --out other.log --every 100 --quiet
    head -c 1000 /dev/zero >zero.log
    : >empty.log
    mkfifo fifo # no process writes to it
    sed "s|^mesh: .*|mesh: $PWD/fifo|" "$scene" >fifo.yaml
    touch marker && sleep 0.02
    refuses "fifo: cannot open the scene: not a regular file" timeout 10 "$replay" --scene fifo --poses poses.log
    refuses "fifo: cannot open the mesh: not a regular file" timeout 10 "$replay" --scene fifo.yaml --poses poses.log
    refuses "fifo: not a regular file" timeout 10 "$replay" --scene "$scene" --poses fifo
    refuses "fifo: not a regular file" timeout 10 "$replay" --scene "$scene" --poses poses.log --compare fifo
    refuses "fifo: cannot be opened: not a regular file" timeout 10 "$device" --plan fifo --scene "$source/meshes/implant.yaml"
    refuses --nonsense "$device" --nonsense
    refuses figure9 "$device" --script figure9
    refuses --rate "$device" --rate 0
    refuses --hand "$device" --hand 1,2
    refuses --start "$device" --start 1,2,nan
    refuses /nowhere/x.log "$device" --write-log /nowhere/x.log
    refuses /nowhere/x.csv "$device" --csv /nowhere/x.csv
    local template=$source/meshes/implant.yaml row=E3,1,0.01,-0.01,0.0675
    printf '%s\n' "hole,seed,x [m],y [m],z [m]" $row >plan.csv
    printf '%s\n' "hole,seed,x [m],y [m],z [m]" ${row/0.0675/0.18} >deep.csv
    printf '%s\n' "hole,seed,x [m],y [m],z [m]" ${row/0.0675/-0.01} >outside.csv
    printf '%s\n' "hole,seed,x [m],y [m],z [m]" ${row/E3/E9} >hole.csv
    printf '%s\n' "hole,seed,x [m],y [m],z [m]" ${row/-0.01/-0.012} >beside.csv
    printf '%s\n' "hole,seed,x [m],y [m],z [m]" $row E3.0,2,0.01,-0.01,0.0645 >overlap.csv
    printf '%s\n' "hole,seed,x [m],y [m],z [m]" $row F3,1,0.005,-0.01,0.0675 E3.0,2,0.01,-0.01,0.06 >apart.csv
    printf '%s\n' "hole,seed,x [m],y [m],z [m]" $row F3,1,0.005,-0.01,0.0675 >two.csv
    sed "/^needles:/d; s|^mesh: |mesh: $source/meshes/|" "$template" >one.yaml
    printf '%s\n' "hole,seed,x [m],y [m],z [m]" >none.csv
    touch marker && sleep 0.02
    refuses "--plan needs --scene" "$device" --plan plan.csv
    refuses "--operator needs --plan" "$device" --operator image
    refuses "expected marks or image" "$device" --plan plan.csv --scene "$template" --operator blind
    refuses "--splay needs --operator image" "$device" --plan plan.csv --scene "$template" --splay 0
    refuses "--stabilise: the scene's template has no hole Z9" "$device" --plan plan.csv --scene "$template" --stabilise C4,Z9
    refuses "--stabilise: hole E3 is taken" "$device" --plan plan.csv --scene "$template" --stabilise E3
    refuses "outside.csv: needle 0: with its tip at 0.01725 m, a seed would not be in the tissue at rest: choose the scene that the plan was made for" "$device" --plan outside.csv --scene "$template"
    refuses "--plan cannot be combined with --script" "$device" --plan plan.csv --scene "$template" --script hold
    refuses "plan.csv: the scene has no template" "$device" --plan plan.csv --scene "$scene"
    refuses "figure8.yaml:1: not a table of planned seeds" "$device" --plan "$scene" --scene "$template"
    refuses "nowhere.csv: cannot be opened" "$device" --plan nowhere.csv --scene "$template"
    refuses "none.csv: no seeds" "$device" --plan none.csv --scene "$template"
    refuses "hole.csv:2: the scene's template has no hole E9: it has 13 x 13" "$device" --plan hole.csv --scene "$template"
    refuses "beside.csv:2: the seed is 2.0 mm beside hole E3" "$device" --plan beside.csv --scene "$template"
    refuses "deep.csv:2: the seed is 205.0 mm behind the template's face, where a needle of 200 mm does not reach" "$device" --plan deep.csv --scene "$template" --csv x.csv
    refuses "overlap.csv:3: the seed is not behind the one before" "$device" --plan overlap.csv --scene "$template"
    refuses "apart.csv:4: the seeds of hole E3.0 are not together" "$device" --plan apart.csv --scene "$template"
    refuses 'the plan has 2 needles, the scene 1: add "needles: 2" to the scene' "$device" --plan two.csv --scene one.yaml
    refuses --nonsense "$replay" --nonsense
    refuses --scene "$replay" --poses poses.log
    refuses --poses "$replay" --scene "$scene"
    refuses none.yaml "$replay" --scene none.yaml --poses poses.log
    refuses none.log "$replay" --scene "$scene" --poses none.log --csv x.csv
    refuses "cut.log: event 7 at byte" "$replay" --scene "$scene" --poses cut.log --csv x.csv --out x.log
    refuses "zero.log: event 0 at byte 0: not an LCM log" "$replay" --scene "$scene" --poses zero.log --csv x.csv
    refuses empty.log "$replay" --scene "$scene" --poses empty.log --csv x.csv
    refuses /nowhere/x.csv "$replay" --scene "$scene" --poses poses.log --csv /nowhere/x.csv --out x.log
    refuses poses.log "$replay" --scene "$scene" --poses poses.log --compare poses.log --csv x.csv
    refuses "which was not replayed" "$replay" --scene "$scene" --poses poses.log --compare other.log
    refuses --compare "$replay" --scene "$scene" --poses poses.log --tolerance 2
    refuses --out "$replay" --scene "$scene" --poses poses.log --every 2
    refuses --shift "$replay" --scene "$scene" --poses poses.log --region prostate
    refuses liver "$replay" --scene "$scene" --poses poses.log --shift x.csv --region liver
    refuses "--at 99 s is after the last pose" "$replay" --scene "$scene" --poses poses.log --vtu x --at 99
    refuses "no benchmark given" "$bench"
    refuses tock "$bench" tock
    refuses --nonsense "$bench" tick --nonsense
    refuses --scene "$bench" tick --json x.json
    refuses "--contacts: 2.5" "$bench" tick --scene "$scene" --contacts 5,2.5
    refuses --side "$bench" dose --side 0
    refuses "--contacts: 65" "$bench" tick --scene "$scene" --contacts 65
    refuses --scene "$parts" remesh --samples 3
    refuses "--touched: 4" "$parts" remesh --scene "$scene" --touched 4
    refuses none.yaml "$parts" remesh --scene none.yaml
    refuses "--inverse: 'big'" "$parts" scale --scene "$scene" --inverse big
    refuses none.yaml "$parts" scale --scene none.yaml
    refuses "has relaxation or guides already" "$bench" features --scene "$source/meshes/template.yaml"
    refuses "--contacts: 2.5" "$bench" features --scene "$scene" --contacts 2.5
    refuses none.yaml "$bench" tick --scene none.yaml --json x.json
    refuses /nowhere/x.json "$bench" tick --scene "$scene" --json /nowhere/x.json
    refuses "contact nodes on its way in, not 64" "$bench" tick --scene "$scene" --contacts 64 --json x.json
    for program in "$device" "$replay" "$bench"; do
        grep -q '^trocar-' <<<"$("$program" --version)" || fail "$program --version"
        grep -q Usage <<<"$("$program" --help)" || fail "$program --help"
    done
}

# Two runs give bit-identical results, and the wrenches in the log equal the rows of the table.
replay() {
    "$programs/trocar-device" --write-log poses.log
    for run in a b; do
        "$programs/trocar-replay" --scene "$scene" --poses poses.log --csv $run.csv --out $run.log --vtu $run --at 1.38 --quiet
    done
    for part in .csv .log -tissue.vtu -needle.vtu; do
        cmp "a$part" "b$part"
    done
    [ "$(wc -l <a.csv)" -eq 2402 ] || fail "rows: $(wc -l <a.csv)"
    # replaying the poses in the log gives the same table; its wrenches are ignored
    "$programs/trocar-replay" --scene "$scene" --poses a.log --csv again.csv --shift shift.csv --quiet
    cmp a.csv again.csv
    # if the scene has no needle with the recorded index, needle 0 is simulated; the log keeps the recorded index
    "$programs/trocar-replay" --scene "$scene" --poses "$source/tests/fuzz/corpus/poselog/two_needles.log" --needle 1 --out second.log --quiet
    python3 - second.log <<'END' || fail "needle or number of needles in the status of a replay's log"
import struct, sys
log = open(sys.argv[1], "rb").read()
channel, size = struct.unpack(">ii", log[20:28])
needle, needles, _, _, _ = struct.unpack(">iiiqi", log[28 + channel + size - 24:28 + channel + size])  # status_t's last fields
sys.exit(not (log[28:28 + channel] == b"TROCAR_STATUS" and needle == 1 and needles == 2))
END
    # the gland is pushed along with the needle, pulled back beyond its starting position, and at rest again once the needle is out
    awk -F, 'NR > 1 { if (NF != 7) exit 2; low = $4 < low ? $4 : low; high = $4 > high ? $4 : high; last = $4 }
             END { exit !(NR == 2402 && high > 0.05 && low < -0.05 && last == 0) }' shift.csv || fail "shift of the gland"
    grep -q 'puncture:skin' a.csv || fail "no puncture of the skin"
    grep -q 'puncture:capsule' a.csv || fail "no puncture of the capsule"
    [ -z "$(find . -name '*.part')" ] || fail "temporary files left"
}

# Checks ParaView's time series: all listed files exist, in the right order, and one of them equals the file that --vtu writes for that time.
series() {
    local run=("$programs/trocar-replay" --scene "$scene" --poses "$source/tests/traces/figure8.log" --quiet)
    mkdir part
    "${run[@]}" --pvd part/series
    /usr/bin/python3 - <<'EOF'
import os, xml.etree.ElementTree as tree
sets = tree.parse("part/series.pvd").getroot().findall("Collection/DataSet")
assert len(sets) == 2 * 73, len(sets)  # 2.4 s at 30 per second, first and last
assert all(os.path.getsize("part/" + s.get("file")) > 1000 for s in sets)
times = [float(s.get("timestep")) for s in sets[::2]]
assert all(0 <= t - k / 30 < 2e-3 for k, t in enumerate(times)), times
EOF
    "${run[@]}" --vtu single --at 1.3
    cmp single-tissue.vtu part/series-0039-tissue.vtu
    cmp single-needle.vtu part/series-0039-needle.vtu
    "$source/tests/clients/check_vtu.py" part/series-0039
}

# Golden recordings with their wrenches: two replays are bit-identical, and agree with the recording to within a tolerance that any change to the mechanics
# would exceed.
golden() {
    local traces=$source/tests/traces trace status=0
    for trace in figure8 again hand lossy; do
        "$programs/trocar-replay" --scene "$scene" --poses "$traces/$trace.log" --out $trace.log --compare "$traces/$trace-golden.log"
    done
    "$programs/trocar-replay" --scene "$scene" --poses figure8.log --out twice.log --compare figure8.log --tolerance 0
    cmp figure8.log twice.log
    sed "s|^mesh: |mesh: $source/meshes/|; /^inverse:/d" "$scene" >sparse.yaml
    echo 'inverse: sparse' >>sparse.yaml
    "$programs/trocar-replay" --scene sparse.yaml --poses figure8.log --compare figure8.log 2>difference || fail "$(cat difference)"
    grep -qF 'figure8.log: recorded with the dense inverse, replayed with the sparse one' difference || fail "the other inverse is not named: $(cat difference)"
    sed "s|^mesh: |mesh: $source/meshes/|; s/kinetic: 9 /kinetic: 10 /" "$scene" >other.yaml
    "$programs/trocar-replay" --scene other.yaml --poses figure8.log --compare "$traces/figure8-golden.log" 2>difference || status=$?
    cat difference
    [ $status -eq 1 ] || fail "status $status, not 1, with other friction"
    grep -qE '^  first: .*fz off by .* N, .* of its peak, at [0-9.]+ s, pose [0-9]+$' difference || fail "the first difference is not explained"
}

# Short benchmark runs that check the output, but not how fast this machine is.
bench() {
    "$programs/trocar-bench" tick --scene "$scene" --contacts 5,10 --ticks 100 --json bench.json >bench.txt
    cat bench.txt
    "$source/tests/clients/check_bench.py" bench.json 5 10
    "$programs/trocar-bench" dose --side 60 --seeds 50 --json dose.json
    "$source/tests/clients/check_dose_bench.py" dose.json 216000 50
    [ "$(grep -cE ' (advance|sweep) ' bench.txt)" -eq 4 ] || fail "not four rows in the table"
    "$programs/trocar-bench" features --scene "$scene" --contacts 5 --ticks 100 --json features.json >features.txt
    cat features.txt
    "$source/tests/clients/check_features_bench.py" features.json
    "$programs/../tests/benchmarks/bench_parts" remesh --scene "$scene" --samples 20 --seconds 0.1 --json remesh.json >remesh.txt
    cat remesh.txt
    "$source/tests/clients/check_remesh_bench.py" remesh.json
    [ "$(grep -cE ' (inside|face|move) ' remesh.txt)" -eq 17 ] || fail "not 17 rows in the table"
    "$source/scripts/plot_bench" remesh.json nodes.svg valence.svg >ratios.txt
    cat ratios.txt
    grep -q '<svg' nodes.svg && grep -q '<svg' valence.svg || fail "no figures"
    "$programs/../tests/benchmarks/bench_parts" scale --scene "$scene" --ticks 50 --depth 0.05 --json scale.json >scale.txt
    cat scale.txt
    "$source/tests/clients/check_scale_bench.py" scale.json dense
    "$source/scripts/plot_scale" tick.svg worker.svg scale.json scale.json
    grep -q '10 contacts' tick.svg && grep -q 'dense, 20 mm/s' worker.svg || fail "no figures of scale"
}

# Tip positions deep in the tissue, with the base moved up, during retraction, and still close to the skin.
balance() {
    "$programs/trocar-device" --write-log poses.log
    for at in 0.3 1.0 1.38 1.8; do
        "$programs/trocar-replay" --scene "$scene" --poses poses.log --vtu "at-$at" --at $at --quiet
        "$source/tests/clients/check_vtu.py" "at-$at"
    done
    # membranes with in-plane stiffness, with each kind of inverse
    for inverse in dense sparse condensed; do
        sed "s|^mesh: |mesh: $source/meshes/|; /^inverse:/d; /puncture_force:/a\\    stiffness: 300" "$scene" >stiff.yaml
        printf 'inverse: %s\ncache: .\n' $inverse >>stiff.yaml
        "$programs/trocar-replay" --scene stiff.yaml --poses poses.log --vtu stiff --at 1.38 --quiet
        [ -e stiff-membranes.vtu ] || fail "no file of membranes"
        "$source/tests/clients/check_vtu.py" stiff
        ! cmp --quiet stiff-needle.vtu at-1.38-needle.vtu || fail "membranes without effect"
    done
}

# At rest, the hand's spring balances the needle's force: z = target + force / stiffness. The virtual coupling is off, because it does not come to rest while
# the delay varies, as happens on a busy machine. Exit status 77: network namespaces are not permitted.
hand() {
    "$source/scripts/netns" true || exit 77
    "$source/scripts/netns" "$source/tests/clients/test_clients.sh" "$programs" "$source" hand_inside
}

hand_inside() {
    sed "s|^mesh: |mesh: $source/meshes/|" "$scene" >rigid.yaml
    echo 'device: {max_stiffness: .inf}' >>rigid.yaml
    "$programs/../server/trocar-server" --scene rigid.yaml --allow-non-rt >server.txt 2>&1 &
    local server=$!
    until grep -qx ready server.txt; do
        kill -0 $server || fail "$(cat server.txt)"
        sleep 0.05
    done
    "$programs/trocar-device" --script insert --realtime --hand 0.3,15,400 --csv hand.csv --report hand.json
    kill $server
    wait $server
    # from 1.5 s to 1.6 s, the script holds the base at z = -0.135 m
    awk -F, 'NR == 1 { for (i = 1; i <= NF; i++) { split($i, name, " "); column[name[1]] = i } next }
             $1 > 1.5 && $1 < 1.6 { rows++; force = $column["fz"]; off = $column["z"] + 0.135 - force / 400
                                    if (off < 0) off = -off; if (off > worst) worst = off }
             END { printf "%d rows, force %.3f N, off balance by %.1e m\n", rows, force, worst
                   exit !(rows > 50 && force < -0.2 && worst < 5e-5) }' hand.csv || fail "the hand is not in equilibrium"
    /usr/bin/python3 -m json.tool hand.json >/dev/null || fail "the report is not JSON"
}

# The figure is drawn from the table and has labels for the events.
figure() {
    "$programs/trocar-device" --write-log poses.log
    "$programs/trocar-replay" --scene "$scene" --poses poses.log --csv forces.csv --quiet
    "$source/scripts/plot_forces" forces.csv forces.svg
    grep -q "</svg>" forces.svg || fail "the figure is truncated"
    for label in axial sagittal coronal skin capsule; do
        grep -q "$label" forces.svg || fail "no '$label' in the figure"
    done
    touch marker && sleep 0.02
    : >bad.csv
    touch -d '1 hour ago' bad.csv
    refuses bad.csv "$source/scripts/plot_forces" bad.csv x.svg
}

"$3"
