#!/usr/bin/python3
"""Tests trocar-haply between trocar-server and a stand-in for the Haply Inverse Service: forces, the clutch, and faults on either side.

usage: test_haply.py BUILD_DIR SOURCE_DIR [--slow]     --slow: for instrumented programs, whose timing is not checked
"""
import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time

BUILD, SOURCE = sys.argv[1:3]
SLOW = "--slow" in sys.argv
WATCHDOG = 0.02    # s, timeout of the watchdogs in server and bridge
SLACK = 1.0 if SLOW else 0.012  # s, allowance for scheduling on top of the watchdog's timeout
LIMIT = 0.6        # N, --max-force
HOME = (0.0, 0.1, 0.1)
DEPTH = 0.04       # m, depth of the insertion

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
sys.dont_write_bytecode = True
from rig import Rig, wait_for
from in_namespace import in_namespace
from standin import Service, use_realtime

in_namespace(SOURCE)


def push(rig, distance=DEPTH, speed=0.05, start=HOME):
    """Pushes the hand forward from `start` and then holds it. Returns the time at which the push began, as soon as the hand is at rest."""
    begin = time.monotonic()
    rig.service.position = lambda now: (start[0], start[1] + min(distance, speed * max(0.0, now - begin)), start[2])
    time.sleep(distance / speed)
    return begin


def settled(rig, seconds=0.15):
    time.sleep(seconds)
    return rig.force()


def becomes(rig, expected, what):
    """Waits until the force is within 5 % of `expected`. (Until then, it may be zero because the machine stalls.)"""
    wait_for(lambda: math.dist(rig.force(), expected) < 0.05 * math.hypot(*expected) + 0.005, f"{what}: {rig.force()} N, expected {expected} N")


def library_force(distance, speed):
    """Returns the force (N) that the library computes for the same insertion, in the scene's frame."""
    os.environ["TROCAR_LIBRARY"] = f"{BUILD}/core/libtrocar.so"
    sys.path.insert(0, f"{BUILD}/clients/python")
    import trocar
    sim = trocar.Sim(trocar.Model(trocar.Scene.load(f"{SOURCE}/meshes/figure8.yaml")))
    base = [0.005, 0.003, -0.201, 1, 0, 0, 0]
    sim.reset(base)
    steps = round(distance / speed * 1000)
    for k in range(1, steps + 101):
        base[2] = -0.201 + min(k, steps) * speed / 1000
        out = sim.step(base, 0.001)
    return out.force


def check_force(rig):
    """Forward is the scene's z axis, right is its -x axis, and up is its y axis. The force equals the library's."""
    expected = None
    if not SLOW:
        fx, fy, fz = library_force(DEPTH, 0.05)
        expected = (-fx, fz, fy)
    push(rig)
    x, y, z = settled(rig)
    wait_for(lambda: rig.force()[1] < -0.1, f"no force against the push: {(x, y, z)}")
    if expected:
        print(f"force {(x, y, z)} N, the library's {expected} N")
        becomes(rig, expected, "not the library's force")
    assert not any(force > LIMIT + 1e-12 for force in rig.norms_since(0)), "above the limit"


def check_greeting(rig):
    """A session's first message names the program; later ones do not."""
    greeting = rig.service.first[0]
    assert greeting["session"]["configure"]["profile"]["name"] == "trocar-haply", greeting
    assert {key for _, _, key in rig.service.forces} == {"vector"}, "the force's name for 3.5"


def check_clutch(rig):
    """While the clutch is pressed, the hand moves without feeling a force, and the needle stays where it is. Afterwards, it follows the hand from there."""
    before, home = rig.force(), rig.service.position(time.monotonic())
    rig.service.buttons["a"] = True
    time.sleep(0.1 if not SLOW else 0.5)
    assert rig.force() == (0, 0, 0), f"force while the clutch is pressed: {rig.force()}"
    moved = (home[0] + 0.02, home[1] - 0.05, home[2])
    rig.service.position = moved
    time.sleep(0.05)
    rig.service.buttons["a"] = False
    becomes(rig, before, "not the same force after the clutch")
    rig.service.position = (moved[0], moved[1] - 0.06, moved[2])  # the needle jumps out of the tissue
    wait_for(lambda: math.hypot(*rig.force()) < 0.01, "the needle does not come out")
    push(rig, DEPTH + 0.001, start=rig.service.position)
    rig.wait_for_force(0.1, "no force after the clutch")


def check_handle(rig):
    """Without a handle, the needle keeps its direction, and the force ramps up again."""
    before = settled(rig, 0.3)
    start = time.monotonic()
    rig.service.handle = None
    wait_for(lambda: re.search("no handle .*61548", rig.said()), "a missing handle is not told")
    wait_for(lambda: min(rig.norms_since(start)) < 0.1 * math.hypot(*before), "no new ramp without a handle")
    becomes(rig, before, "not the same force without a handle")
    rig.service.handle = "wireless_verse_grip"
    rig.service.orientation = (2.0, 0.0, 0.0, 0.0)  # not a rotation, so the orientation counts as missing
    time.sleep(0.1)
    rig.service.orientation = (1.0, 0.0, 0.0, 0.0)
    settled(rig, 0.25)
    assert rig.said().count("no handle") == 1, "told more than once"


def damaged(**changes):
    """Returns a function for `answer` that sets these members of the device's object."""
    def answer(state):
        state["inverse3"][0].update(changes)
        return json.dumps(state)
    return answer


BAD = {
    "cut off": (lambda state: json.dumps(state)[:200], "incomplete JSON"),
    "empty": (lambda state: "", "incomplete JSON"),
    "not UTF-8": (lambda state: b"\xff\xfe{", "incomplete JSON"),
    "deeply nested": (lambda state: "[" * 100000, "incomplete JSON"),
    "a number": (lambda state: "17", "another format"),
    "format 3.0": (lambda state: json.dumps({"inverse3": {"049D": state["inverse3"][0]}}), "port 10000 has format 3.0"),
    "no list": (lambda state: json.dumps({"session_id": 7}), "no such device"),
    "another device": (damaged(device_id="0000"), "no such device"),
    "an ID with a quote": (damaged(device_id='04"9D'), "no such device"),
    "not calibrated": (damaged(status={"calibrated": False}), "not calibrated"),
    "no state": (damaged(state=None), "state.cursor_position"),
    "not a number": (damaged(state={"cursor_position": {"x": "0", "y": 0, "z": 0}}), "state.cursor_position"),
    "NaN": (damaged(state={"cursor_position": {"x": float("nan"), "y": 0, "z": 0}}), "incomplete JSON"),
    "huge": (damaged(state={"cursor_position": {"x": 1e300, "y": -1e300, "z": 1e308}}), "state.cursor_position"),
    "infinite": (lambda state: json.dumps(state).replace('"cursor_position": {"x": 0.0', '"cursor_position": {"x": 1e999'), "state.cursor_position"),
    "long": (lambda state: json.dumps({**state, "more": "x" * 70000}), ""),
    "too long": (lambda state: json.dumps({**state, "more": "x" * 300000}), "incomplete JSON"),
}


def check_bad_messages(rig):
    """Only a message with a state produces a force. Each kind of fault is reported once, together with what was expected."""
    for name, (answer, expected) in BAD.items():
        rig.wait_for_force(0.1, f"no force before the message: {name}")
        begin, inquiries = time.monotonic(), rig.service.inquiries
        rig.service.answer = answer
        if expected:
            wait_for(lambda: expected in rig.said(), f"{name}: '{expected}' is not told: {rig.said()}")
            wait_for(lambda: rig.service.inquiries > inquiries or rig.force() == (0, 0, 0), f"{name}: still {rig.force()} N")
        time.sleep(0.03)
        late = rig.since(begin + (1.0 if SLOW else 0.01))
        if expected:
            assert all(force == (0, 0, 0) for _, force in late), f"{name}: force {late}"
        else:
            rig.wait_for_force(0.1, f"{name}: no force")
        rig.service.answer = json.dumps
    rig.wait_for_force(0.1, "no force after bad messages")
    for line in set(rig.said().splitlines()):
        assert rig.said().count(line) == 1 or "connected" in line, f"told more than once: {line}"
    rig.service.answer = lambda state: json.dumps({"new": [1, {"a": None}], **state, "inverse3": [{**state["inverse3"][0], "novelty": 1}]})
    settled(rig)
    rig.wait_for_force(0.1, "unknown fields matter")
    rig.service.answer = json.dumps


def check_late_reply(rig):
    """The next message to a service that does not respond has zero force."""
    rig.wait_for_force(0.1, "no force")
    rig.service.answer = lambda state: time.sleep(0.2) or json.dumps(state)
    time.sleep(0.1)
    rig.service.answer = json.dumps
    begin = time.monotonic()
    wait_for(lambda: rig.since(begin), "nothing after a late reply")
    assert rig.since(begin)[0][1] == (0, 0, 0), f"the first force after a late reply: {rig.since(begin)[0]}"
    rig.wait_for_force(0.1, "no force after a late reply")
    assert rig.said().count("more than 20 ms to reply") == 1, rig.said()


def check_catching_up(rig):
    """After one reply that takes 0.1 s, every reply takes three periods. The force is back 0.5 s after the slow reply began."""
    rig.wait_for_force(0.1, "no force")
    began = []

    def answer(state):
        time.sleep(0.003 if began else 0.1)
        began.append(time.monotonic())
        return json.dumps(state)
    rig.service.answer = answer
    wait_for(lambda: rig.force() == (0, 0, 0), "force during a hang")
    wait_for(lambda: math.hypot(*rig.force()) > 0.1, "no force between slow replies after a hang", 5 if SLOW else 0.5)
    rig.service.answer = json.dumps


def check_lost_reply(rig):
    """A reply never arrives. One more message is sent, with zero force. After 1 s a new connection is made, and the force is back within 2 s."""
    rig.wait_for_force(0.1, "no force")
    lost = []
    rig.service.answer = lambda state: json.dumps(state) if lost else lost.append(time.monotonic())
    wait_for(lambda: lost and rig.since(lost[0]), "nothing after a reply that never comes")
    sessions = len(rig.service.first)
    time.sleep(max(0, lost[0] + 0.8 - time.monotonic()))
    sent = rig.since(lost[0])
    assert SLOW or [force for _, force in sent] == [(0, 0, 0)], f"{len(sent)} messages without a reply: {sent[:5]}"
    wait_for(lambda: len(rig.service.first) > sessions and math.hypot(*rig.force()) > 0.1, "no force after a reply that never comes", 10 if SLOW else 1.2)
    assert "no reply from the service" in rig.said(), rig.said()
    rig.service.answer = json.dumps


def check_frozen_state(rig):
    """The service repeats its last state. The force ends after 0.5 s, and this is reported. When the state changes again, the force ramps up from zero."""
    rig.wait_for_force(0.1, "no force")
    rig.service.frozen = True
    began = time.monotonic()
    wait_for(lambda: rig.force() == (0, 0, 0), "force for a state that is frozen")
    lasted = time.monotonic() - began
    assert lasted > 0.4, f"no force after {lasted} s"
    settled(rig, 1)
    assert rig.force() == (0, 0, 0), "force again, although nothing has changed"
    assert rig.said().count("exactly the same state for 0.5 s") == 1, rig.said()
    moved = time.monotonic()
    rig.service.frozen = False
    rig.wait_for_force(0.1, "no force when the state changes again")
    rise = [math.hypot(*force) for _, force in rig.since(moved)]
    assert SLOW or max(b - a for a, b in zip(rise, rise[1:])) < 0.05, f"a jump: {rise[:50]}"
    print(f"a frozen state: force for another {1e3 * lasted:.0f} ms")


def check_disconnection(rig):
    """The bridge reconnects and sends its first message again, and the force ramps up from zero."""
    opened = rig.said().count("connected to the service")
    for _ in range(2):
        begin, sessions = time.monotonic(), len(rig.service.first)
        rig.service.disconnect()
        wait_for(lambda: len(rig.service.first) > sessions, "not connected again")
        wait_for(lambda: rig.since(begin + 0.1), "nothing after a connection") # the bridge retries twice per second
        assert math.hypot(*rig.since(begin + 0.1)[0][1]) < 0.01, "force at once after a connection"
        rig.wait_for_force(0.1, "no force after a connection")
    assert rig.said().count("the connection was closed; is it running?") == 2 and rig.said().count("connected to the service") == opened + 2, rig.said()


def check_server(rig):
    """The force ends shortly after the server has stopped, and this is reported. It is back when the server continues or another one starts."""
    rig.wait_for_force(0.1, "no force")
    rig.server.send_signal(signal.SIGSTOP)
    stopped = time.monotonic()
    time.sleep(0.7 if not SLOW else 2.5)
    late = rig.force_without_server(stopped, time.monotonic())
    rig.server.send_signal(signal.SIGCONT)
    assert late < WATCHDOG + SLACK, f"force for {late} s without a server"
    print(f"the server was stopped: force for another {1e3 * late:.0f} ms")
    wait_for(lambda: "no wrench from trocar-server" in rig.said(), "not told that the server is silent")
    rig.wait_for_force(0.1, "no force after the server's stop")
    answers = rig.said().count("trocar-server answers")
    assert answers == 2, rig.said()
    killed = time.monotonic()
    rig.kill_server()
    time.sleep(0.7)
    late = rig.force_without_server(killed, time.monotonic())
    assert late < WATCHDOG + SLACK, f"force for {late} s after the server's death"
    rig.service.position = HOME
    rig.start_server()
    push(rig)
    rig.wait_for_force(0.1, "no force of the next server")
    assert rig.said().count("trocar-server answers") == 3, rig.said()


def check_end(rig):
    """The last message has zero force."""
    rig.wait_for_force(0.1, "no force")
    begin = time.monotonic()
    assert rig.stop_bridge() == 0, "status"
    assert rig.force() == (0, 0, 0), f"the last force is {rig.force()}"
    assert SLOW or time.monotonic() - begin < 0.5, "slow to end"
    late = int(re.search("in all.* ([0-9]+) late", rig.out.read_text()).group(1))
    assert SLOW or 3 <= late < 50, f"{late} late replies, of three that were late and those of a busy machine"


def check_options():
    """Invalid options and profiles lead to exit status 2 and a message that says where the error is and what was expected."""
    program = f"{BUILD}/clients/bridges/haply/trocar-haply"
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/profile.yaml"
        for text, place in (("max_force: 2\nrotation: [1, 0, 0]\n", ":2"), ("speed: 3\n", ":1"), ("scale: {x: 1}\n", ":1"), ("- 1\n", ":1"), ("a: [\n", ":2"),
                            ("realtime: 3\n", ":1"), ("scale: " + "1" * 2000, ":1"), ("profile: x\n", ":1"), ("max_force: 2\nscale: 1\nmax-force: 3\n", ":3"),
                            ("max_force: 2\n---\nmax_force: 3\n", ":2")):
            open(path, "w").write(text)
            done = subprocess.run([program, "--profile", path], capture_output=True, text=True, timeout=20)
            assert done.returncode == 2 and path + place in done.stderr, (text, done)
        for options in (["--max-force", "-1"], ["--scale", "nan"], ["--rotation", "1,1,1,1"], ["--point", "middle"], ["--direction", "0,0,0"],
                        ["--service", ""], ["--service", "localhost:0"], ["--device", "x" * 64], ["--start", "0,0,0", "--offset", "0,0,0"],
                        ["--force-key", "x"], ["more"], ["--profile", "nowhere.yaml"], ["--lcm-url", "nowhere://"]):
            done = subprocess.run([program, *options], capture_output=True, text=True, timeout=20)
            assert done.returncode == 2, (options, done)


def check_other_version(folder):
    """Tests versions 3.1 to 3.4 of the service with a wired handle, events, a profile whose maximum force is lowered on the command line, the tip at the
    cursor, and another rotation, in which right is the scene's z."""
    profile = f"{folder}/profile.yaml"
    open(profile, "w").write("point: tip\nstart: [0.005, 0.003, -0.001]\nrotation: [0.7071068, 0, -0.7071068, 0]\norientation: fixed\nmax_force: 0.4\nscale: 2\n")
    rig = Rig(BUILD, SOURCE, folder, realtime=True, version="3.4")
    rig.service.handle, rig.service.position = "verse_grip", HOME
    events = Service()
    events.answer = lambda state: json.dumps({"name": "device-battery-low", "category": "device", "level": "warning", "data": {}, "message": "15 %"})
    try:
        rig.start_server()
        rig.start_bridge("--max-force", "0.2", "--profile", profile, "--report", "1", "--realtime", "--events", str(events.port))
        begin = time.monotonic()
        rig.service.position = lambda now: (HOME[0] + min(0.02, 0.025 * (now - begin)), *HOME[1:])
        time.sleep(0.8)
        becomes(rig, (-0.2, 0, 0), "not the limit, to the left")
        assert max(rig.norms_since(0)) <= 0.2 + 1e-12, f"above the limit: {max(rig.norms_since(0))}"
        assert {key for _, _, key in rig.service.forces} == {"values"}, "the force's name before 3.5"
        rig.service.buttons["a"] = True # a button on the wired handle
        wait_for(lambda: rig.force() == (0, 0, 0), "the wired handle's button is no clutch")
        assert "the service reports warning: device-battery-low: 15 %" in rig.said(), rig.said()
        assert rig.bridge.poll() is None
    finally:
        rig.end()
        events.stop()


def main():
    use_realtime()
    check_options()
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(BUILD, SOURCE, folder, realtime=True)
        rig.service.position = HOME
        try:
            rig.start_server()
            rig.start_bridge("--max-force", str(LIMIT), "--report", "2", "--realtime")
            for check in (check_force, check_greeting, check_clutch, check_handle, check_bad_messages, check_late_reply, check_catching_up, check_lost_reply, check_frozen_state, check_disconnection, check_server, check_end):
                begin = time.monotonic()
                check(rig)
                print(f"{check.__name__}: {time.monotonic() - begin:.1f} s", flush=True)
            assert max(rig.norms_since(0)) <= LIMIT + 1e-12, f"above the limit: {max(rig.norms_since(0))}"
        except AssertionError:
            print(rig.said(), (rig.folder / "server").read_text()[-2000:], file=sys.stderr)
            raise
        finally:
            rig.end()
        check_other_version(folder)
    print("passed")


if __name__ == "__main__":
    main()
