#!/usr/bin/python3
"""Tests trocar-top --udp-json with a running server and a listener: the datagrams must be JSON and have the values of the LCM messages.

usage: test_udp_json.py BUILD_DIR SOURCE_DIR
Exit status 77: network namespaces are not available.
"""
import collections
import json
import os
import re
import signal
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../shared"))
from in_namespace import in_namespace
from lcm_packets import lcm_socket, message_of

BUILD, SOURCE = sys.argv[1:3]
TOP = f"{BUILD}/clients/trocar-top"


def bind(port):
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    listener.bind(("127.0.0.1", port))
    listener.settimeout(0.5)
    return listener


def listen(listener, seconds):
    """Returns the JSON objects that arrive within this time."""
    found, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            found.append(json.loads(listener.recv(65536), parse_constant=lambda name: 1 / 0))   # fails for NaN and Infinity
        except TimeoutError:
            pass
    return found


class Wrenches(threading.Thread):
    """The wrenches on the network, by tick, with force, depth and contacts, decoded from LCM's packets."""

    def __init__(self):
        super().__init__(daemon=True)
        self.socket = lcm_socket()
        self.of_tick, self.poses = {}, collections.deque(maxlen=10000)
        self.start()

    def run(self):
        while True:
            channel, data = message_of(self.socket.recv(65536))
            if channel == b"TROCAR_WRENCH":
                utime, tick = struct.unpack_from(">qq", data)
                force, torque = struct.unpack_from(">3d", data, 40), struct.unpack_from(">3d", data, 64)
                depth, contacts, events = struct.unpack_from(">dii", data, 136)
                self.of_tick[tick] = utime, force, torque, depth, contacts, events
            elif channel == b"TROCAR_POSE":
                self.poses.append(struct.unpack_from(">3d", data, 24))


def xyz(vector):
    assert list(vector) == ["x", "y", "z"], vector
    return tuple(vector.values())


def compare(objects, wrenches):
    """Checks that the values are bit-identical to those of the tick's wrench. Returns the JSON objects that have a wrench."""
    time.sleep(0.1)  # the thread may not have received the last wrench yet
    found = [o for o in objects if "tick" in o.get("needle0", {})]
    for o in found:
        n = o["needle0"]
        utime, force, torque, depth, contacts, _ = wrenches.of_tick[n["tick"]]
        assert abs(o["timestamp"] - 1e-6 * utime) < 2e-6, (o["timestamp"], utime)
        assert (xyz(n["force_N"]), xyz(n["torque_Nm"]), n["depth_m"], n["contacts"]) == (force, torque, depth, contacts), (n, wrenches.of_tick[n["tick"]])
        assert "base_m" not in n or xyz(n["base_m"]) in wrenches.poses, n
    return found


def names(value, name=""):
    """Yields the names that PlotJuggler gives to the numbers in a JSON object."""
    if isinstance(value, dict):
        return {each for key in value for each in names(value[key], f"{name}/{key}")}
    return {name} if isinstance(value, (int, float)) else set()


def check_layout(objects):
    curves = re.findall('<curve name="([^"]+)"', open(f"{SOURCE}/docs/examples/plotjuggler-live.xml").read())
    sent = set().union(*map(names, objects))
    assert len(curves) > 10 and set(curves) < sent, set(curves) - sent


def check_period(found, wrenches, period):
    """Checks that the time between two datagrams is at least `period` (us) minus 0.1 ms, and usually not much longer. On a busy machine, wrenches may be lost
    before trocar-top reads them."""
    gaps = [wrenches.of_tick[after["needle0"]["tick"]][0] - wrenches.of_tick[before["needle0"]["tick"]][0] for before, after in zip(found, found[1:])]
    assert len(gaps) > 4 and min(gaps) >= period - 100 and statistics.median(gaps) < 1.5 * period, gaps


def check_events(found, wrenches):
    """Checks that the next datagram reports the events of the ticks that were not sent, and no others."""
    gathered = 0
    for before, after in zip(found, found[1:]):
        n, events = after["needle0"], 0
        for tick in range(before["needle0"]["tick"] + 1, n["tick"] + 1):
            events |= wrenches.of_tick[tick][5]
        assert n["events"] & ~events == 0, (after, events)
        gathered |= n["events"] & ~wrenches.of_tick[n["tick"]][5]
    assert gathered, "no event of an earlier tick"


def start(*arguments, **options):
    return subprocess.Popen(arguments, stdin=subprocess.DEVNULL, text=True, **options)


def start_server():
    server = start(f"{BUILD}/server/trocar-server", "--scene", f"{SOURCE}/meshes/figure8.yaml", "--allow-non-rt", stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert any(line == "ready\n" for line in server.stdout), "the server does not start"
    return server


def end(process):
    process.send_signal(signal.SIGTERM)
    said = process.communicate(timeout=10)
    assert process.returncode == 0, (process.returncode, said)
    return said


def live():
    wrenches, server = Wrenches(), start_server()
    device = start(f"{BUILD}/clients/trocar-device", "--script", "figure8", "--duration", "60", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 20
    while not any(contacts > 0 for *_, contacts, _ in list(wrenches.of_tick.values())):
        assert time.monotonic() < deadline, "the device does not touch anything"
        time.sleep(0.1)

    listener = bind(9870)
    top = start(TOP, "--udp-json", "localhost:9870", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    objects = listen(listener, 1.5)
    found = compare(objects, wrenches)
    check_layout(objects)
    print(f"{len(found)} wrenches in {found[-1]['timestamp'] - found[0]['timestamp']:.3f} s, {len(objects)} datagrams")
    check_period(found, wrenches, 10000)
    assert any(o["needle0"]["contacts"] > 0 and "base_m" in o["needle0"] for o in found), found[-1]
    loops, states = [o["loop"] for o in objects if "loop" in o], [o["needle0"] for o in objects if "pose_age_s" in o.get("needle0", {})]
    assert len(loops) > 3 and all(0 < loop["compute_p50_s"] < 0.1 and loop["rate_Hz"] == 1000 for loop in loops), loops
    assert len(states) > 3 and states[-1]["owned"] is True and states[-1]["poses_accepted"] > states[0]["poses_accepted"] > 0, states

    # The listener stops and is started again, and so is the server.
    listener.close()
    time.sleep(0.5)
    listener = bind(9870)
    assert listen(listener, 1.5), "nothing after the listener has come back"
    server.kill()
    server.wait()
    time.sleep(1.5)
    listen(listener, 0.1)
    server = start_server()
    assert compare(listen(listener, 1.0), wrenches), "nothing after the server's restart"
    said = end(top)
    assert said[0] == "", said[0]                # without a terminal, trocar-top prints nothing
    lines = [line.removeprefix("trocar-top: ") for line in said[1].splitlines()]
    wanted = ["localhost:9870: no program listens there", "localhost:9870: ", "no server was heard", "a server is heard"]
    assert len(lines) == 4 and all(map(str.startswith, lines, wanted)), lines

    top = start(TOP, "--udp-json", "127.0.0.1:9870", "--udp-rate", "0", "--plain", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    time.sleep(0.2)
    listen(listener, 0.1)
    found = compare(listen(listener, 1.0), wrenches)
    ticks = [o["needle0"]["tick"] for o in found]
    print(f"every wrench: {len(ticks)} of {ticks[-1] - ticks[0] + 1}")
    assert len(set(ticks)) == len(ticks) > 0.5 * (ticks[-1] - ticks[0]) and len(ticks) > 200
    time.sleep(1.2)
    said = end(top)
    assert "udp json    127.0.0.1:9870: " in said[0] and "lateness" in said[0], said
    # Events in wrenches that are not forwarded are reported with the next one that is.
    listener.close()                             # discards the datagrams received in the meantime
    listener = bind(9870)
    top = start(TOP, "--udp-json", "127.0.0.1:9870", "--udp-rate", "5", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    found = compare(listen(listener, 3.0), wrenches)
    end(top)
    check_period(found, wrenches, 200000)
    check_events(found, wrenches)
    device.kill()
    server.kill()


def refuses(*arguments, why):
    done = subprocess.run([TOP, *arguments], capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=20)
    assert done.returncode == 2 and why in done.stderr and done.stdout == "", f"{arguments}: status {done.returncode}, {done.stderr}"


def main():
    in_namespace(SOURCE)
    for to in ("localhost", "localhost:", "localhost:0", "localhost:65536", "localhost:9870x", ":9870", "::1:9870", "[]:1", "x" * 300 + ":1", ""):
        refuses("--udp-json", to, why="expected HOST:PORT")
    refuses("--udp-json", "host.invalid:9870", why="the host is not known")
    refuses("--udp-json", "203.0.113.1:9870", why="cannot be reached: Network is unreachable")     # no route leads out of the namespace
    refuses("--udp-rate", "10", why="--udp-rate needs --udp-json")
    refuses("--udp-json", "localhost:1", "--udp-rate", "-1", why="--udp-rate")
    refuses("--once", "--udp-json", "localhost:1", why="--once")
    live()
    print("passed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
