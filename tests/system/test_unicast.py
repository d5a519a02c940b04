#!/usr/bin/python3
"""Tests unicast clients on another machine (a network namespace at the other end of a cable), and attacks on them.

- An insertion over udp:// ends with the same force and depth as over multicast on the server's machine.
- An attacker between client and server replays, reorders, truncates, forges and floods while a client holds a needle still. Only poses that the client has
  sent reach LCM, each of them once, nothing stops the server, and the client renders only what the server sends. Hardly a wrench is lost, and the server's ticks
  are hardly later than without an attack. Prints what each attack cost, and writes it to CSV (docs/results/unicast-attacks.csv).
- A restarted server accepts nothing from an earlier connection, and the client connects to it again. If it has another secret, the client says so.
- SHUTDOWN is accepted only from a session that holds a needle.
- Without a secret, or with one that is short or that others can read, the server does not start.

usage: test_unicast.py BUILD_DIR SOURCE_DIR [CSV]
"""
import collections
import csv
import ctypes
import os
import random
import re
import secrets
import select
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time

BUILD, SOURCE = sys.argv[1:3]
sys.dont_write_bytecode = True
sys.path[:0] = [f"{SOURCE}/tests/shared", f"{SOURCE}/tests/system"]
import unicast
from in_namespace import in_namespace

HERE, THERE, PORT, GROUP = "10.0.0.1", "10.0.0.2", 7668, ("239.255.76.67", 7667)
HELD = (0.005, 0.003, -0.201)   # m, where insertion.c holds the needle
FLOOD = 20000                   # datagrams per second that a flood aims at
SECONDS = 2                     # duration of each attack
AT_ONCE = ["chrt", "--fifo", "20"] if subprocess.run(["chrt", "--fifo", "20", "true"], capture_output=True).returncode == 0 else []
CLIENT = f"{BUILD}/tests/client_library/insertion_counted"
ANSWERED, UNANSWERED, DISCONNECTED, REFUSED = range(4)      # the client's state
rng = random.Random(1)


def flood(descriptor, templates):
    """Reads an address, which is empty if the socket is connected, and sends it copies of these datagrams, changed at random, until standard input is closed.
    Prints how many were sent, and in how many seconds."""
    link, tried, sent = socket.socket(fileno=descriptor), 0, 0
    print("ready", flush=True)
    host, _, port = sys.stdin.readline().strip().partition(" ")
    send = (lambda data: link.sendto(data, (host, int(port)))) if host else link.send
    begin = time.monotonic()
    while not select.select([sys.stdin], [], [], 0.001)[0]:
        while tried < FLOOD * (time.monotonic() - begin):
            data = bytearray(rng.choice(templates))
            data[rng.randrange(4, len(data))] ^= 1 + rng.randrange(255)
            tried += 1
            try:
                sent += send(data) == len(data)
            except OSError:
                pass
    print(sent, time.monotonic() - begin)
    link.detach()


# ---- the two machines -----------------------------------------------------------------------------------------------------

class Machine:
    """The other machine."""

    def __init__(self):
        self.keeper = subprocess.Popen(["unshare", "--net", "sleep", "1000"])
        while os.readlink(f"/proc/{self.keeper.pid}/ns/net") == os.readlink("/proc/self/ns/net"):
            time.sleep(0.01)
        self.enter = ["nsenter", "--target", str(self.keeper.pid), "--net"]
        for command in (f"ip link add lan type veth peer name lan netns {self.keeper.pid}", f"ip address add {HERE}/24 dev lan", "ip link set lan up"):
            subprocess.run(command.split(), check=True)
        for command in (f"ip address add {THERE}/24 dev lan", "ip link set lan up", "ip link set lo up"):
            subprocess.run([*self.enter, *command.split()], check=True)

    def socket(self):
        libc = ctypes.CDLL(None, use_errno=True)
        with open(f"/proc/{self.keeper.pid}/ns/net") as far, open("/proc/self/ns/net") as near:
            assert libc.setns(far.fileno(), 0) == 0
            made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)     # stays in the other namespace
            assert libc.setns(near.fileno(), 0) == 0
        return made

    def client(self, url, *arguments):
        return subprocess.Popen([*self.enter, *AT_ONCE, CLIENT, url, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(client):
    out, error = client.communicate(timeout=60)
    assert client.returncode == 0, error
    return {name: float(value) for name, value in map(str.split, out.splitlines())}


class Server:
    def __init__(self, scene, secret):
        self.log = tempfile.TemporaryFile("w+")
        self.process = subprocess.Popen([f"{BUILD}/server/trocar-server", "--scene", scene, "--allow-non-rt", "--listen", f":{PORT}", "--secret-file", secret],
                                        stdout=self.log, stderr=subprocess.STDOUT)
        while "\nready\n" not in self.text():
            assert self.process.poll() is None, self.text()
            time.sleep(0.05)

    def text(self):
        self.log.seek(0)
        return self.log.read()

    def processor_time(self):
        """Returns the relay thread's CPU time (s)."""
        for task in os.listdir(f"/proc/{self.process.pid}/task"):
            with open(f"/proc/{self.process.pid}/task/{task}/comm") as name, open(f"/proc/{self.process.pid}/task/{task}/schedstat") as times:
                if name.read().strip() == "trocar-relay":
                    return 1e-9 * int(times.read().split()[0])


class Bus(threading.Thread):
    """Receives all LCM messages on the server's machine, as lcm-logger would."""

    def __init__(self, types):
        super().__init__(daemon=True)
        self.types = types
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.socket.bind(GROUP)
        self.socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP[0]) + socket.inet_aton("127.0.0.1"))
        self.clear()
        self.start()

    def clear(self):
        self.poses, self.wrong, self.wrenches, self.timing = collections.Counter(), 0, collections.Counter(), []     # wrenches: by session

    def run(self):
        while True:
            channel, _, data = self.socket.recv(65536)[8:].partition(b"\0")
            if channel == b"TROCAR_POSE":
                m = self.types.needle_pose_t.decode(data)
                self.poses[m.session, m.seq] += 1
                self.wrong += tuple(m.position) != HELD
            elif channel == b"TROCAR_WRENCH":
                self.wrenches[struct.unpack_from(">q", data, 24)[0]] += 1
            elif channel == b"TROCAR_TIMING":
                m = self.types.loop_timing_t.decode(data)
                self.timing.append((m.lateness_p99, m.lateness_max, m.misses, m.ticks))


# ---- the attacker -------------------------------------------------------------------------------------------------------------

class Between(threading.Thread):
    """An attacker that passes datagrams between a client and the server. attack(datagram) returns the datagrams that the receiver gets instead of a message of
    the kind `target`."""

    def __init__(self, machine):
        super().__init__(daemon=True)
        self.front, self.back, self.spare = machine.socket(), machine.socket(), machine.socket()
        self.front.bind(("127.0.0.1", PORT))
        self.back.connect((HERE, PORT))
        self.spare.connect((HERE, PORT))
        self.attack, self.target, self.client = None, None, None
        self.clear()
        self.start()

    def clear(self):
        self.sent, self.answers, self.extra, self.client = [], [], 0, None  # extra: the attacker's datagrams; a genuine one counts if it is sent again or late

    def put(self, datagram, to_client=False):
        """Returns whether the datagram was sent."""
        try:
            if not to_client:
                self.back.send(datagram)
            elif self.client:
                self.front.sendto(datagram, self.client)
            return not to_client or self.client is not None
        except OSError:
            return False

    def run(self):
        while True:
            for ready in select.select([self.front, self.back], [], [])[0]:
                try:
                    data, sender = ready.recvfrom(2048)
                except OSError:
                    continue
                if ready is self.front:
                    self.client = sender
                    self.sent.append(data)
                else:
                    self.answers.append(data)
                passed = False
                for each in self.attack(data) if self.attack and data[3] == self.target else [data]:
                    is_extra = each is not data or passed
                    passed |= each is data
                    self.extra += self.put(each, to_client=ready is self.back) and is_extra


def attacks(between, types, earlier):
    """Yields each attack's name, the kind of messages that it concerns, and its function, or the socket to flood the server through. `earlier` are the datagrams of
    an earlier connection, by kind."""
    held, wrong = [], unicast.tag(b"", b"")

    def replayed(data):
        passed = between.sent if data[3] == unicast.TO_SERVER else between.answers
        return [data, data, rng.choice(passed), passed[-1 - rng.randrange(min(100, len(passed)))]]

    def from_earlier(data):
        return [data, *rng.choices(earlier[data[3]], k=3)]

    def reordered(data):
        held.append(data)
        release = b"TROCAR_COMMAND" in data     # the client's last message: a pose overtaken by it would take the needle again
        if len(held) < 4 and not release:
            return []
        out = held[-2::-1] + [data] if release else held[::-1]
        held.clear()
        return out

    def truncated(data):
        return [data[:rng.randrange(len(data))], data, data[:-1], data + b"\0"]

    def altered(channel, content):
        if channel == b"TROCAR_POSE":
            m = types.needle_pose_t.decode(content)
            m.seq += 1
            m.position = [0.005, 0.003, HELD[2] + 0.001]
        elif channel == b"TROCAR_WRENCH":
            m = types.needle_wrench_t.decode(content)
            m.tick += 1
            m.force = [0.0, 0.0, 5.0]
        else:
            return content
        return m.encode()

    def forged(data):
        counter, (channel, _, content) = struct.unpack(">Q", data[4:12])[0], data[12:-32].partition(b"\0")
        ahead = data[:4] + struct.pack(">Q", counter + 1) + data[12:]
        flipped = bytearray(data)
        flipped[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        content = altered(channel, content)
        command = types.command_t()
        command.command, command.session = types.command_t.SHUTDOWN, struct.unpack(">q", content[16:24])[0] if content else 0
        return [ahead, bytes(flipped), data, unicast.message(wrong, counter + 2, b"TROCAR_COMMAND", command.encode(), data[3]),
                unicast.message(wrong, counter + 1, channel, content, data[3]), data[:-32 - len(content)] + content + data[-32:]]

    yield "none", None, None
    for kind, where in ((unicast.TO_SERVER, "to the server: "), (unicast.TO_CLIENT, "to the client: ")):
        yield where + "replayed", kind, replayed
        yield where + "replayed from an earlier connection", kind, from_earlier
        yield where + "reordered", kind, reordered
        yield where + "truncated", kind, truncated
        yield where + ("forged, with poses moved by 1 mm" if kind == unicast.TO_SERVER else "forged, with forces of 5 N"), kind, forged
    yield "to the server: flooded from the client's address", unicast.TO_SERVER, between.back
    yield "to the server: flooded from elsewhere", unicast.TO_SERVER, between.spare
    yield "to the client: flooded from the server's address", unicast.TO_CLIENT, between.front


class Flood:
    """A flood through a socket. It begins once it is told an address, or none for a connected socket."""

    def __init__(self, link, kind, earlier):
        fresh = (b"TROCAR_POSE", bytes(112), unicast.HELLO) if kind == unicast.TO_SERVER else (b"TROCAR_WRENCH", bytes(188), unicast.WELCOME)
        templates = [unicast.message(bytes(32), 1, *fresh[:2], kind), unicast.handshake(bytes(32), fresh[2], bytes(16)), rng.choice(earlier[kind])]
        self.process = subprocess.Popen([sys.executable, __file__, BUILD, SOURCE, "flood", str(link.fileno()), *(t.hex() for t in templates)],
                                        pass_fds=[link.fileno()], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout.readline() == "ready\n"

    def begin(self, address=()):
        self.process.stdin.write(" ".join(map(str, address)) + "\n")
        self.process.stdin.flush()

    def end(self):
        """Returns the number of datagrams sent, and the time that it took (s)."""
        sent, lasted = map(float, self.process.communicate("end", timeout=10)[0].split())
        return int(sent), lasted


def wait_until(condition, longest=10):
    end = time.monotonic() + longest
    while not condition():
        assert time.monotonic() < end, "nothing happens"
        time.sleep(0.001)


HEAD = ["Attack, %d s each" % SECONDS, "Attacker's datagrams", "Poses moved / relayed twice", "Periods answered", "Largest force",
        "Wrenches lost or overtaken, at the client", "Lateness, median p99", "Late ticks", "Relay thread"]
Cost = collections.namedtuple("Cost", "answered lost missed late")      # fractions of the periods, wrenches and ticks; median of the p99 lateness, s


def under_attack(machine, between, bus, server, types, earlier, table):
    quiet, rows = None, []
    for name, target, attack in attacks(between, types, earlier):
        flooding = Flood(attack, target, earlier) if isinstance(attack, socket.socket) else None
        between.attack, between.target = attack if callable(attack) else None, target
        between.clear()
        bus.clear()
        busy, begin = server.processor_time(), time.monotonic()
        if flooding and target == unicast.TO_SERVER:
            flooding.begin()
        client = machine.client(f"udp://127.0.0.1:{PORT}", str(SECONDS))
        if flooding and target == unicast.TO_CLIENT:
            wait_until(lambda: between.client)
            flooding.begin(between.client)
        felt = finish(client)
        seconds = time.monotonic() - begin
        extra = between.extra
        if flooding:
            extra, lasted = flooding.end()
            name += f", {extra / lasted:.0f} per second"
            assert extra > 0.9 * FLOOD * lasted, f"the flood has only {extra / lasted:.0f} datagrams per second"
        time.sleep(0.1)
        between.attack = None
        (session,) = {session for session, _ in bus.poses}
        twice, wrenches = sum(n > 1 for n in bus.poses.values()), bus.wrenches[session]
        late, longest, misses, ticks = zip(*bus.timing)
        cost = Cost(felt["answered"] / felt["periods"], 1 - felt["accepted"] / wrenches, (misses[-1] - misses[0]) / (ticks[-1] - ticks[0]), statistics.median(late))
        rows.append([name, extra, f"{bus.wrong} / {twice}", f"{felt['answered']:.0f} of {felt['periods']:.0f}", f"{felt['most']:g} N",
                     f"{wrenches - felt['accepted']:.0f} of {wrenches}", f"{1e3 * cost.late:.2f} ms", misses[-1] - misses[0],
                     f"{100 * (server.processor_time() - busy) / seconds:.0f} %"])
        print(*rows[-1], sep="; ", flush=True)
        quiet = quiet or cost
        assert server.process.poll() is None, server.text()
        assert name == "none" or extra > 100, "no attack"
        assert bus.wrong == 0 and twice == 0, "something else moved the needle"
        assert felt["most"] == 0 and felt["back"] == 0, "the client renders what the server has not sent: in front of the skin, there is no force"
        assert cost.answered > max(0.5, quiet.answered - 0.05), "the client gets no wrenches"
        reordered = name == "to the client: reordered"      # of four wrenches that arrive in reverse order, the client drops the three older ones
        assert cost.lost < quiet.lost + (0.76 if reordered else 0.005), "wrenches are lost"
        assert cost.missed < quiet.missed + 0.01 and cost.late < quiet.late + 0.5e-3, "the attack makes ticks late"
    if table:
        with open(table, "w", encoding="ascii", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([HEAD, *rows])


# ---- the tests ------------------------------------------------------------------------------------------------------------------

def make_secret(path, characters=64, mode=0o600):
    with open(os.open(path, os.O_WRONLY | os.O_CREAT, mode), "w", encoding="ascii") as file:
        file.write(secrets.token_hex(characters // 2) + "\n")
    os.chmod(path, mode)
    return path


def bad_settings(scene, folder):
    open_secret, short = make_secret(f"{folder}/open", mode=0o644), make_secret(f"{folder}/short", 30)
    for arguments, wanted in ((["--listen", f"0.0.0.0:{PORT}"], "needs --secret-file"), (["--listen", f"0.0.0.0:{PORT}", "--secret-file", open_secret], "chmod 600"),
                              (["--listen", f"0.0.0.0:{PORT}", "--secret-file", short], "has 32 to 1024 bytes"),
                              (["--listen", f"0.0.0.0:{PORT}", "--secret-file", f"{folder}/none"], "No such file"),
                              (["--listen", "7668"], "give HOST:PORT"), (["--secret-file", short], "no effect without --listen")):
        done = subprocess.run([f"{BUILD}/server/trocar-server", "--scene", scene, "--allow-non-rt", *arguments], capture_output=True, text=True, timeout=60)
        assert done.returncode == 2 and wanted in done.stderr, (arguments, done)


def same_insertion(machine, url):
    near = finish(subprocess.Popen([*AT_ONCE, CLIENT, "udpm://239.255.76.67:7667?ttl=0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
    far = finish(machine.client(url))
    print(f"multicast: {near}\nunicast:   {far}")
    assert abs(far["force"] - near["force"]) < 0.01 * near["force"] and abs(far["depth"] - near["depth"]) < 0.01 * near["depth"]
    assert far["resets"] == 1 and far["back"] == 0


def wrong_secret(machine, url, folder):
    os.environ["TROCAR_SECRET_FILE"], right = make_secret(f"{folder}/other"), os.environ["TROCAR_SECRET_FILE"]
    client = machine.client(url, "1")
    error = client.communicate(timeout=20)[1]
    os.environ["TROCAR_SECRET_FILE"] = right
    assert client.returncode == 1 and error.count("\n") == 1 and "refuses the secret" in error, error


def restart(machine, between, bus, server, scene, secret):
    """Returns the new server. The client connects to it; datagrams from its connection to the old server have no effect."""
    client = machine.client(f"udp://127.0.0.1:{PORT}", "8")
    between.sent = []
    time.sleep(2)
    old = list(between.sent)
    server.process.kill()
    server.process.wait()
    server = Server(scene, secret)
    end = time.monotonic() + 3
    while not any(data[3] == unicast.CONNECT for data in between.sent[len(old):]) and time.monotonic() < end:
        time.sleep(0.01)
    bus.clear()
    for data in old:
        between.put(data)
    felt = finish(client)
    print(f"restart: {felt['answered']:.0f} of {felt['periods']:.0f} periods answered, {felt['outages']:.0f} outages")
    assert all(count == 1 for count in bus.poses.values()) and bus.wrong == 0, "the new server accepted a replay"
    assert len(bus.poses) > 500, "the client did not connect to the new server"
    assert felt["state"] == ANSWERED, felt
    return server


def other_secret(machine, url, server, scene, secret, folder):
    """Returns a server that replaces this one. Between them, another server with another secret runs."""
    client = machine.client(url, "5")
    time.sleep(1)
    server.process.kill()
    server.process.wait()
    other = Server(scene, make_secret(f"{folder}/another"))
    felt = finish(client)
    assert felt["state"] == REFUSED, felt
    other.process.kill()
    other.process.wait()
    return Server(scene, secret)


def shutdown(machine, server, types, secret):
    link = machine.socket()
    link.connect((HERE, PORT))
    client = unicast.Connection(link, secret)
    command = types.command_t()
    command.session, command.command, command.seq = 77, types.command_t.SHUTDOWN, 1
    client.send(b"TROCAR_COMMAND", command.encode())
    (channel, data), = client.receive(0.3)
    reply = types.command_reply_t.decode(data)
    assert channel == b"TROCAR_REPLY" and reply.status == reply.REFUSED and "another machine" in reply.message, reply.message
    pose = types.needle_pose_t()
    pose.session, pose.position, pose.orientation = 77, HELD, [1, 0, 0, 0]
    for pose.seq in range(20):
        client.send(b"TROCAR_POSE", pose.encode())
        time.sleep(0.002)
    command.seq = 2
    client.send(b"TROCAR_COMMAND", command.encode())
    assert server.process.wait(10) == 0, "the owner of a needle cannot shut it down"
    print(re.search("^unicast +[0-9].*", server.text(), re.MULTILINE)[0])


def main():
    in_namespace(SOURCE)
    if AT_ONCE:
        subprocess.run(["chrt", "--fifo", "--pid", "20", str(os.getpid())], check=True)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["lcm-gen", "-p", "--ppath", folder, f"{SOURCE}/lcmtypes/trocar.lcm"], check=True)
        sys.path.insert(0, folder)
        import trocar as types
        scene, secret = f"{folder}/scene.yaml", make_secret(f"{folder}/secret")
        with open(f"{SOURCE}/meshes/figure8.yaml", encoding="utf-8") as given, open(scene, "w", encoding="utf-8") as file:
            file.write(given.read().replace("mesh: ", f"mesh: {SOURCE}/meshes/") + "\ndevice: {max_stiffness: .inf}\n")
        bad_settings(scene, folder)
        os.environ["TROCAR_SECRET_FILE"] = secret
        machine, server = Machine(), Server(scene, secret)
        try:
            bus, between, url = Bus(types), Between(machine), f"udp://{HERE}:{PORT}"
            same_insertion(machine, url)
            wrong_secret(machine, url, folder)
            finish(machine.client(f"udp://127.0.0.1:{PORT}", "1"))
            under_attack(machine, between, bus, server, types, {unicast.TO_SERVER: list(between.sent), unicast.TO_CLIENT: list(between.answers)},
                         *sys.argv[3:4] or [None])
            server = restart(machine, between, bus, server, scene, secret)
            server = other_secret(machine, url, server, scene, secret, folder)
            shutdown(machine, server, types, secret)
        finally:
            server.process.kill()
            machine.keeper.kill()
    print("passed")


if sys.argv[3:4] == ["flood"]:
    flood(int(sys.argv[4]), [bytes.fromhex(text) for text in sys.argv[5:]])
else:
    main()
