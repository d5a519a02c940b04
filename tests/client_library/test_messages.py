#!/usr/bin/python3
"""Compares the messages of the Python and C# clients with those of lcm-gen. Random messages are decoded and re-encoded to the same bytes, and damaged ones are
refused. Random datagrams do not crash the Python client, nor do random wrenches from its server exceed its limits. It waits for pending changes, and refuses
long ones. The C# client says why it cannot read a secret. (test_client.py and tests/fuzz cover the other clients.)

usage: test_messages.py SOURCE_DIR python|csharp
"""
import math
import random
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from types import SimpleNamespace

SOURCE, LANGUAGE = sys.argv[1:3]
ROUNDS = 2000
sys.dont_write_bytecode = True
rng = random.Random(1)

sys.path.insert(0, f"{SOURCE}/lcmtypes")
import message_types

STRUCTS = {s.name: s for s in message_types.read(f"{SOURCE}/lcmtypes/trocar.lcm")[1]}


def number(size):
    return int.from_bytes(rng.randbytes(size), "big", signed=True)


def real():
    return rng.choice([rng.gauss(0, 1), float("inf"), -0.0, 5e-324, struct.unpack(">d", b"\x40" + rng.randbytes(7))[0]])


def make(types, letter):
    """A random message."""
    name = {"p": "needle_pose_t", "c": "command_t", "w": "needle_wrench_t", "r": "command_reply_t"}[letter]
    m = getattr(types, name)()
    for line in STRUCTS[name].fields():
        field = line.name.split("[")[0]
        if line.type == "string":
            setattr(m, field, "".join(chr(rng.randint(32, 126)) for _ in range(rng.randrange(255))))
        elif line.type == "double":
            now = getattr(m, field)
            setattr(m, field, [real() for _ in now] if isinstance(now, list) else real())
        else:
            setattr(m, field, number({"int32_t": 4, "int64_t": 8}[line.type]))
    return m


def damage(data):
    """Corrupts the bytes until they are no longer a valid message."""
    kind = rng.randrange(3)
    if kind == 0:
        return data[:rng.randrange(len(data))]
    if kind == 1:
        return data + rng.randbytes(rng.randint(1, 20))
    at = rng.randrange(8)
    return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1:]


def try_python(types, cases):
    sys.path.insert(0, f"{SOURCE}/clients/python")
    import trocar_client as client
    kinds = {"p": client._NEEDLE_POSE, "c": client._COMMAND, "w": client._NEEDLE_WRENCH, "r": client._COMMAND_REPLY}
    for letter, data, message in cases:
        found = kinds[letter].decode(data)
        assert (found is None) == (message is None), (letter, data)
        if message is None:
            continue
        for name, value in found.items():
            wanted = getattr(message, name)
            assert tuple(value) == tuple(wanted) if isinstance(value, tuple) else value == wanted, (letter, name)
        if letter != "r":   # the clients do not send strings
            assert kinds[letter].encode(**found) == data, letter
    datagrams(client, cases)
    pending(client, types)
    too_long(client)
    for bad in ({"needle": -1}, {"watchdog": float("nan")}, {"max_force": -1}):     # bad arguments are refused before a socket is opened
        try:
            client.Client(**bad)
        except ValueError as error:
            assert next(iter(bad)) in str(error)
        else:
            raise AssertionError(bad)


class Alone:
    """An unconnected client, which can process datagrams without a network."""

    def __new__(cls, client):
        client.Client._connect = lambda self, url: None
        client.Client._receive_until_end = lambda self: None
        return client.Client()


def use_clock(client, clock):
    """Puts the client's time under the test's control."""
    client.time = SimpleNamespace(**{**vars(time), "monotonic": lambda: clock[0]})


def datagrams(client, cases):
    c, clock, last, answered, largest = Alone(client), [100.0], (0.0, 0.0, 0.0), 0, 0.0
    use_clock(client, clock)
    for letter, _, message in cases:
        if message is not None and letter in "wr":
            message.session, message.needle, message.server = c._session, 0, 1
    messages = [data if message is None else message.encode() for _, data, message in cases]
    names = [b"TROCAR_WRENCH", b"TROCAR_REPLY", b"LCM_SELF_TEST", b"TROCAR_POSE", b""]
    for _ in range(20 * ROUNDS):
        message, name = rng.choice(messages), rng.choice(names)
        if rng.random() < 0.5:
            packet = struct.pack(">4sI", b"LC02", number(2) & 0xFF) + name + b"\0" + message
        else:
            packet = struct.pack(">4sIIIHH", b"LC03", rng.randrange(3), rng.choice([len(message), 2 * len(message), number(4) & 0xFFFFFFFF]),
                                 rng.choice([0, len(message), number(4) & 0xFFFFFFFF]), rng.randrange(4), rng.randrange(4))
            packet += (name + b"\0" if rng.random() < 0.5 else b"") + message
        c._take_datagram(packet if rng.random() < 0.8 else packet[:rng.randrange(len(packet))], ("127.0.0.1", rng.randrange(2)))
        clock[0] += 0.001
        wrench = c.newest()
        assert sum(x * x for x in wrench.force) <= 20 ** 2 * (1 + 1e-9), "more than max_force"
        assert math.dist(wrench.force, last) <= 2000 * 0.001 * (1 + 1e-9) or not wrench.answered, "faster than max_force_rate"
        last, answered, largest = wrench.force, answered + wrench.answered, max(largest, *map(abs, wrench.force))
    print(f"{answered} of {20 * ROUNDS} periods answered, at most {largest:.1f} N")
    assert answered > ROUNDS / 2 and largest > 10, "the client accepts no wrenches"


def pending(client, types):
    """As long as the server reports that a change is pending, the client waits longer than usual for the reply."""
    c, clock = Alone(client), [100.0]
    use_clock(client, clock)
    c._send = lambda channel, message: None
    reply = types.command_reply_t()
    reply.server, reply.session, reply.command = 1, c._session, types.command_t.CHANGE

    def hear(seq, status):
        reply.seq, reply.status, reply.message = seq, status, "computing"
        c._take_message(b"TROCAR_REPLY", reply.encode())

    for number, told in ((1, True), (2, False)):
        assert c.change({"regions[0].youngs_modulus": 1e3})
        for _ in range(20):
            clock[0] += 1.0
            if told:
                hear(number, reply.PENDING)
                assert c.reply() == (client.Answer.WAITING, "computing") and not c.change({"a": 1})
        hear(number - 1, reply.PENDING)     # a reply to an earlier change does not count
        clock[0] += 2.9
        assert c.reply()[0] is (client.Answer.WAITING if told else client.Answer.UNANSWERED)
        clock[0] += 0.2
        assert c.reply()[0] is client.Answer.UNANSWERED
        hear(number, reply.DONE)
        assert c.reply()[0] is client.Answer.DONE


def too_long(client):
    """Changes that the server would refuse, and that its unicast port would drop without a reply, are not sent."""
    c, sent = Alone(client), []
    c._send = lambda channel, message: sent.append(message)
    for key, size in ((509 * "k", 512), (510 * "k", 513), (255 * "\u00e9", 513)):    # bytes, with ": 1"
        try:
            c.change({key: 1})
        except ValueError as error:
            assert size > 512 and f"{size} bytes" in str(error) and "at most 512" in str(error)
        else:
            assert size == 512, "a long change is sent"
    assert len(sent) == 1 and sent[0].endswith(509 * b"k" + b": 1\0")


def try_csharp(folder, cases):
    subprocess.run(["mcs", "-langversion:7", "-warn:4", "-warnaserror", f"-out:{folder}/Messages.exe", f"{SOURCE}/clients/client/TrocarClient.cs",
                    f"{SOURCE}/tests/client_library/Messages.cs"], check=True)
    given = b"".join(letter.encode() + struct.pack("<H", len(data)) + data for letter, data, _ in cases)
    got = subprocess.run(["mono", f"{folder}/Messages.exe"], input=given, stdout=subprocess.PIPE, check=True).stdout
    at = 0
    for letter, data, message in cases:
        size, = struct.unpack_from("<H", got, at)
        assert got[at + 2:at + 2 + size] == (b"" if message is None else data), (letter, data, got[at + 2:at + 2 + size])
        at += 2 + size
    assert at == len(got)


def main():
    if LANGUAGE == "csharp" and not (shutil.which("mcs") and shutil.which("mono")):
        print("skipped: no mcs or mono; install mono-mcs and mono-runtime")
        sys.exit(77)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["lcm-gen", "-p", "--ppath", folder, f"{SOURCE}/lcmtypes/trocar.lcm"], check=True)
        sys.path.insert(0, folder)
        import trocar as types
        cases = []
        for letter in "pcwr" * ROUNDS:
            message = make(types, letter)
            cases += [(letter, message.encode(), message), (letter, damage(message.encode()), None)]
        try_python(types, cases) if LANGUAGE == "python" else try_csharp(folder, cases)
        print(f"{len(cases)} messages")


main()
