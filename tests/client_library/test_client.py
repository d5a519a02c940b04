#!/usr/bin/python3
"""Tests one of the free clients in a bridge that inserts a needle: insertion.c, built for this system or for Windows (under Wine), Insertion.cs and
UnityInsertion.cs (under Mono), or insertion.py.

- The needle comes to rest with the force and depth that the library gives, both on a good network and on one that loses every tenth datagram, duplicates
  every twentieth and shuffles their order within 4 ms. No wrench is followed by an older one. The needle follows the hand rigidly, because a virtual coupling
  would be softer for a longer round trip.
- The bridge survives crafted packets and a flood of fuzzed fragments, and still gets answers.
- The insertion is the same over udp://, without multicast. A client with another secret is refused with one clear message.
- The client tells whether wrenches arrive, none do, or no server answers.
- The component for Unity keeps no force when it is disabled or fails.
- With a server that sends 1000 N, the force and torque stay within the client's limits, also on their rates. Without wrenches, they are zero after 20 ms.
- An attacker between server and client forges, alters and repeats wrenches over udp://. The client renders none of them.
- Wrenches that arrive in fragments and out of order are rendered as well.
- With ttl=0, wrenches from another machine are not rendered; with ttl=1 they are.

usage: test_client.py BUILD_DIR SOURCE_DIR c|windows|csharp|unity|python
"""
import ctypes
import json
import math
import os
import random
import secrets
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

BUILD, SOURCE, LANGUAGE = sys.argv[1:4]
HERE, CLIENTS = f"{SOURCE}/tests/client_library", f"{SOURCE}/clients/client"
UNICAST = "127.0.0.1:7670"
NEAR, PORT, FAR = "239.255.76.67", 7667, "239.255.76.68:7668"
LOSS, TWICE, DELAY = 0.1, 0.05, 0.004
ANSWERED, UNANSWERED, DISCONNECTED = range(3)   # a client's state
WATCHDOG, RAMP = 0.02, 0.1              # s, the clients' defaults
MOST, RATE = (20, 1), (2000, 100)       # their limits on force (N) and torque (N m), and on their change per second
NEEDED = {"windows": {"x86_64-w64-mingw32-gcc": "gcc-mingw-w64-x86-64-win32", "wine": "wine64 and wine"}, "csharp": {"mcs": "mono-mcs", "mono": "mono-runtime"}}
NEEDED["unity"] = NEEDED["csharp"]
BRIDGES = {"csharp": [f"{HERE}/Insertion.cs"], "unity": [f"{HERE}/UnityInsertion.cs", f"{CLIENTS}/TrocarNeedle.cs", f"{SOURCE}/tests/project/standins/UnityEngine.cs"]}

sys.path[:0] = [f"{SOURCE}/tests/shared", f"{SOURCE}/tests/system"]
sys.dont_write_bytecode = True
import unicast
from in_namespace import in_namespace

for command, package in NEEDED.get(LANGUAGE, {}).items():
    if not shutil.which(command):
        print(f"skipped: no {command}; install {package}")
        sys.exit(77)
in_namespace(SOURCE)
# Uses real-time priority, as a bridge does, if permitted, so that a busy machine does not look like a fault.
AT_ONCE = ["chrt", "--fifo", "20"] if subprocess.run(["chrt", "--fifo", "20", "true"], capture_output=True).returncode == 0 else []


def build(folder):
    """Returns the command that runs the bridge. Compiles the bridge first if necessary, with the compiler's strictest warnings as errors."""
    if LANGUAGE == "c":
        return [f"{BUILD}/tests/client_library/insertion"]
    if LANGUAGE == "python":
        return ["/usr/bin/python3", "-I", "-W", "error", f"{HERE}/insertion.py"]
    if LANGUAGE in BRIDGES:
        subprocess.run(["mcs", "-langversion:7", "-warn:4", "-warnaserror", f"-out:{folder}/Insertion.exe", f"{CLIENTS}/TrocarClient.cs", *BRIDGES[LANGUAGE]],
                       check=True)
        return ["mono", f"{folder}/Insertion.exe"]
    subprocess.run(["x86_64-w64-mingw32-gcc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2", "-DTROCAR_CLIENT_UNICAST", f"-I{CLIENTS}", "-o",
                    f"{folder}/insertion.exe", f"{HERE}/insertion.c", f"{CLIENTS}/trocar_client.c", "-lws2_32", "-lwinmm", "-lbcrypt"], check=True)
    os.environ.update(WINEPREFIX=f"{folder}/wine", WINEDEBUG="-all", WINEDLLOVERRIDES="mscoree,mshtml=")
    subprocess.run(["wine", "wineboot", "-i"], check=True, capture_output=True)
    return ["wine", f"{folder}/insertion.exe"]


def until_ready(command):
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    for line in program.stdout:
        if line.strip() == "ready":
            return program
    sys.exit(f"{command[0]} ended before it was ready")


def numbers(text):
    return {name: float(value) for name, value in map(str.split, text.splitlines())}


def insertion(bridge, url):
    done = subprocess.run([*bridge, url], capture_output=True, text=True, timeout=60)
    print(f"{url}: {' '.join(done.stdout.split())} {done.stderr}")
    assert done.returncode == 0
    return numbers(done.stdout)


# ---- the same insertion on two networks ------------------------------------------------------------------------------------

def rigid_scene(folder):
    with open(f"{SOURCE}/meshes/figure8.yaml", encoding="utf-8") as file, open(f"{folder}/scene.yaml", "w", encoding="utf-8") as scene:
        scene.write(file.read().replace("mesh: ", f"mesh: {SOURCE}/meshes/") + "\ndevice: {max_stiffness: .inf}\n")
    return scene.name


def library(scene):
    """Returns the force (N) and depth (m) at the end of the insertion."""
    os.environ["TROCAR_LIBRARY"] = f"{BUILD}/core/libtrocar.so"
    sys.path.insert(0, f"{BUILD}/clients/python")
    import trocar
    sim = trocar.Sim(trocar.Model(trocar.Scene.load(scene)))
    for tick in range(2600):
        base = [0.005, 0.003, -0.201 + min(0.021, 1e-5 * tick), 1, 0, 0, 0]
        if tick == 0:
            sim.reset(base)
        out = sim.step(base, 1e-3)
    return math.hypot(*out.force), out.depth


def make_secret(path):
    with open(os.open(path, os.O_WRONLY | os.O_CREAT, 0o600), "w", encoding="ascii") as file:
        file.write(secrets.token_hex(16) + "\n")
    return path


def refused(bridge, folder):
    """A client with another secret fails, and says so in one line."""
    path = make_secret(f"{folder}/other")
    done = subprocess.run([*bridge, f"udp://{UNICAST}", "1"], capture_output=True, text=True, timeout=60, env=dict(os.environ, TROCAR_SECRET_FILE=path))
    print(done.stderr)
    assert done.returncode != 0 and done.stderr.count("refuses the secret of") == 1, done


def without_server(bridge):
    done = subprocess.run([*bridge, f"udp://{UNICAST}", "0.1"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and numbers(done.stdout).get("state", DISCONNECTED) == DISCONNECTED, done


def same_insertion(bridge, folder):
    scene = rigid_scene(folder)
    os.environ["TROCAR_SECRET_FILE"] = make_secret(f"{folder}/secret")
    server = until_ready([f"{BUILD}/server/trocar-server", "--scene", scene, "--allow-non-rt", "--listen", UNICAST, "--secret-file", f"{folder}/secret"])
    link = until_ready([*AT_ONCE, sys.executable, f"{HERE}/lossy_link.py", f"{NEAR}:{PORT}", FAR, str(LOSS), str(TWICE), str(DELAY)])
    try:
        good, bad = insertion(bridge, f"udpm://{NEAR}:{PORT}?ttl=0"), insertion(bridge, f"udpm://{FAR}?ttl=0")
        direct = insertion(bridge, f"udp://{UNICAST}")
        refused(bridge, folder)
        link.terminate()
        done = json.loads(link.communicate(timeout=10)[0])
        client = subprocess.Popen([*bridge, f"udpm://{NEAR}:{PORT}?ttl=0", "5"], stdout=subprocess.PIPE, text=True)
        subprocess.run([sys.executable, f"{SOURCE}/tests/system/crafted_packets.py", "2"], check=True)
        fired_at = numbers(client.communicate(timeout=30)[0])
        print(f"under fire: {fired_at['answered']:.0f} of {fired_at['periods']:.0f} periods answered")
    finally:
        link.kill()
        server.kill()
    force, depth = library(scene)
    print(f"link: {done}\nlibrary: force {force:.6f} depth {depth:.6f}")
    for way in (0, 1):  # both directions: from the server, and to it
        total = done["passed"][way] + done["lost"][way]
        assert total > 500 and abs(done["lost"][way] - LOSS * total) < 4 * math.sqrt(LOSS * total) and done["overtaken"][way] > 0.05 * total, f"the link is another one: {done}"
    for felt in (good, bad, direct):
        assert felt["back"] == 0, "an older wrench followed a newer one"
        assert felt["outages"] == 0 and felt["answered"] == felt["periods"], "the watchdog expired"
        assert abs(felt["force"] - force) < 0.01 * force and abs(felt["depth"] - depth) < 0.01 * depth, "not the insertion of the library"
        assert math.isclose(felt.get("along", -force), -force, rel_tol=0.01), "not along the needle"
        assert felt["resets"] >= 1, "no reply"
        assert felt.get("state", ANSWERED) == ANSWERED, "wrenches arrive"
        if LANGUAGE == "unity":
            assert felt["held"] > 0 and felt["held_again"] > 0 and felt["disabled"] == felt["enabled"] == felt["fault"] == 0, "the component keeps a wrench"
    assert good["resets"] == direct["resets"] == 1
    assert client.returncode == 0 and fired_at["answered"] > 0.3 * fired_at["periods"] and fired_at["back"] == 0, "crafted packets stop it"


# ---- a server that sends too much or nothing, and an attacker -----------------------------------------------------------------

def serve_and_attack(host, types, client):
    """Acts as the server until the client ends: sends 1 N for half a second, nothing, 1000 N, and nothing again. Also acts as an attacker without the key, who
    sends 5 N, flips bits, and repeats the server's datagrams as soon as the server is silent. Returns the server's forces and torques by tick."""
    sent, recorded, begin, rng = {}, [], None, random.Random(1)
    wrench, strange = types.needle_wrench_t(), types.needle_wrench_t()
    wrench.server = strange.server = 5
    strange.force = [0.0, 5.0, 0.0]
    while client.poll() is None:
        time.sleep(0.001)
        for channel, data in host.take():
            if channel == b"TROCAR_POSE":
                wrench.session = strange.session = types.needle_pose_t.decode(data).session
                begin = begin or time.monotonic()
        phase = int((time.monotonic() - begin) / 0.5) if begin else None
        if phase in (0, 2):
            wrench.tick += 2
            strange.tick = wrench.tick + 1
            sent[wrench.tick] = force, torque = (1.0, 0.02) if phase == 0 else (1000.0, 50.0)
            wrench.force, wrench.torque = [force, 0.0, 0.0], [0.0, 0.0, torque]
            genuine, data = host.seal(b"TROCAR_WRENCH", wrench.encode()), strange.encode()
            altered = genuine[:-32 - len(data)] + data + genuine[-32:]
            flipped = bytearray(genuine)
            flipped[rng.randrange(len(flipped))] ^= 1 << rng.randrange(8)
            forged = unicast.message(bytes(32), host.counter + 1, b"TROCAR_WRENCH", data, unicast.TO_CLIENT)
            for datagram in (altered, flipped, genuine, forged):
                host.put(datagram)
            recorded.append(genuine)
        elif recorded:
            for datagram in (recorded[-1], rng.choice(recorded)):
                host.put(datagram)
    return sent


def check_rendered(periods, sent):
    """Checks that each period's force and torque follow from what the server sent. periods: rows of the time before and after the client was asked for the wrench
    (s), the wrench's tick (0: none), force and torque."""
    first_seen, newest, began = {}, 0, periods[0][0]
    for (last_before, _, _, *last), (before, after, tick, *felt) in zip(periods, periods[1:]):
        if tick == 0:
            began = before
            assert felt == [0, 0], "a force without a wrench"
            continue
        assert tick in sent, "a forged wrench is rendered"
        assert tick >= newest, "a repeated wrench is rendered"
        assert before < first_seen.setdefault(tick, after) + WATCHDOG, "a wrench is rendered for too long"
        newest = tick
        for size, previous, wanted, most, rate in zip(felt, last, sent[tick], MOST, RATE):
            allowed = min(most, wanted * min(1, (after - began) / RAMP), previous + rate * (after - last_before))
            assert size <= allowed * (1 + 1e-6), f"{size} is rendered in place of {wanted}, where {allowed} is allowed"


def only_what_the_server_sends(bridge, folder, types):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        address, port = UNICAST.split(":")
        link.bind((address, int(port)))
        path = f"{folder}/periods"
        client = subprocess.Popen([*bridge, f"udp://{UNICAST}", "2", path], stdout=subprocess.PIPE, text=True)
        sent = serve_and_attack(unicast.Host(link, os.environ["TROCAR_SECRET_FILE"]), types, client)
    with open(path, encoding="ascii") as file:
        periods = [tuple(map(float, line.split())) for line in file]
    check_rendered(periods, sent)
    for given, wanted in (((1, 0.02), (1, 0.02)), ((1000, 50), MOST)):
        felt = [max(column) for column in zip(*(period[3:] for period in periods if sent.get(period[2]) == given))]
        print(f"{given[0]} N rendered as {felt[0]:.3f} N, {given[1]} N m as {felt[1]:.4f} N m")
        assert felt[0] > 0.9 * wanted[0] and felt[1] > 0.9 * wanted[1], "the server's wrenches are not rendered"
    assert client.returncode == 0 and periods[-1][2] == 0, "the watchdog has not expired"
    assert numbers(client.stdout.read()).get("state", UNANSWERED) == UNANSWERED, "no wrenches arrive"


# ---- another machine -------------------------------------------------------------------------------------------------------

def run(command):
    subprocess.run(command.split(), check=True)


def plug_in():
    """Simulates another machine, 10.0.0.2, at the other end of a cable. Returns the process that keeps its namespace alive, and a socket in that namespace."""
    other = subprocess.Popen(["unshare", "--net", "sleep", "1000"])
    while os.readlink(f"/proc/{other.pid}/ns/net") == os.readlink("/proc/self/ns/net"):
        time.sleep(0.01)
    there = f"nsenter --target {other.pid} --net ip"
    for command in (f"ip link add lan type veth peer name lan netns {other.pid}", "ip address add 10.0.0.1/24 dev lan", "ip link set lan up",
                    f"ip route replace {NEAR}/32 dev lan", f"{there} address add 10.0.0.2/24 dev lan", f"{there} link set lan up",
                    f"{there} route add {NEAR}/32 dev lan"):
        run(command)
    libc = ctypes.CDLL(None, use_errno=True)
    with open(f"/proc/{other.pid}/ns/net") as far, open("/proc/self/ns/net") as near:
        assert libc.setns(far.fileno(), 0) == 0
        distant = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)  # stays in the other namespace
        assert libc.setns(near.fileno(), 0) == 0
    return other, distant


def turned(q, v):
    """Returns the vector rotated by a quaternion."""
    w, (x, y, z) = q[0], q[1:]
    t = [2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])]
    return [v[0] + w * t[0] + y * t[2] - z * t[1], v[1] + w * t[1] + z * t[0] - x * t[2], v[2] + w * t[2] + x * t[1] - y * t[0]]


def hear_pose(types):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((NEAR, PORT))
        listener.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(NEAR) + socket.inet_aton("10.0.0.1"))
        listener.settimeout(10)
        while True:
            channel, _, message = listener.recv(65536)[8:].partition(b"\0")
            if channel == b"TROCAR_POSE":
                return types.needle_pose_t.decode(message)


def whole(message, _):
    yield b"LC02\0\0\0\0TROCAR_WRENCH\0" + message


def fragments(message, sequence):
    """Returns four fragments, with fragment 0 first and one of them twice."""
    size = -(-len(message) // 4)
    for number in (0, 2, 1, 2, 3):
        part = message[size * number:size * (number + 1)]
        yield struct.pack(">4sIIIHH", b"LC03", sequence, len(message), size * number, number, 4) + (b"" if number else b"TROCAR_WRENCH\0") + part


def answered(bridge, types, sender, ttl, cut=whole):
    """Returns the fraction of periods in which the bridge renders the wrenches that `sender` sends to the group and directly to the bridge's machine."""
    client = subprocess.Popen([*bridge, f"udpm://{NEAR}:{PORT}?ttl={ttl}", "2"], stdout=subprocess.PIPE, text=True)
    wrench, pose = types.needle_wrench_t(), hear_pose(types)
    wrench.session, wrench.server, wrench.force = pose.session, 5, [1.0, 0.0, 0.0]
    ends = threading.Event()

    def send():
        while not ends.wait(0.001):
            wrench.tick += 1
            for to in (NEAR, "10.0.0.1"):
                for packet in cut(wrench.encode(), wrench.tick):
                    try:
                        sender.sendto(packet, (to, PORT))
                    except OSError:
                        pass
    thread = threading.Thread(target=send)
    thread.start()
    felt = numbers(client.communicate(timeout=30)[0])
    ends.set()
    thread.join()
    for name, axis in (("up", (0, 1, 0)), ("forward", (0, 0, 1))) if LANGUAGE == "unity" else ():
        assert math.dist([felt[f"{name}_{i}"] for i in "xyz"], turned(pose.orientation, axis)) < 1e-5, f"{name} is wrong"
    return felt["answered"] / felt["periods"]


def other_machine(bridge, types):
    other, distant = plug_in()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
            distant.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
            found = {"this machine, ttl=0": answered(bridge, types, here, 0), "in fragments": answered(bridge, types, here, 0, fragments),
                     "another machine, ttl=0": answered(bridge, types, distant, 0),
                     "another machine, ttl=1": answered(bridge, types, distant, 1)}
    finally:
        other.kill()
    print(f"wrenches rendered: {found}")
    assert found.pop("another machine, ttl=0") == 0 and min(found.values()) > 0.5


def message_types(folder):
    subprocess.run(["lcm-gen", "-p", "--ppath", folder, f"{SOURCE}/lcmtypes/trocar.lcm"], check=True)
    sys.path.insert(0, folder)
    sys.modules.pop("trocar", None)     # the Python package
    import trocar
    return trocar


def main():
    with tempfile.TemporaryDirectory() as folder:
        try:
            bridge = [*AT_ONCE, *build(folder)]
            same_insertion(bridge, folder)
            without_server(bridge)
            types = message_types(folder)
            only_what_the_server_sends(bridge, folder, types)
            other_machine(bridge, types)
        finally:
            if LANGUAGE == "windows":
                subprocess.run(["wineserver", "-k", "-w"], check=False)


main()
