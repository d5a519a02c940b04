#!/usr/bin/python3
"""Changes the tissue of a running server a thousand times, and its moduli twenty times, while a needle in it is still or moving. No tick may change the force
noticeably, no more ticks may be missed than without changes, bad changes must be refused without effect, and a replay of the recording must give the same
forces. Exit status 77: network namespaces are not permitted.

usage: test_changes.py BUILD_DIR SOURCE_DIR
"""
import math
import random
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
sys.path[:0] = [str(SOURCE / "tests/shared"), str(SOURCE / "clients/python")]
from in_namespace import in_namespace
from lcm_packets import lcm_socket

in_namespace(SOURCE)
sys.dont_write_bytecode = True
import trocar_client
from trocar_client import Answer

CHANGES, PERIOD = 1000, 0.02    # PERIOD: s
MODULI = 10    # changes of moduli while the needle is still, and again while it moves
SCENE = SOURCE / "meshes/figure8.yaml"
URL = "udpm://239.255.76.67:7667?ttl=0&recv_buf_size=4194304"   # recv_buf_size: bytes, enough for a second's messages in case the machine is busy
RECOIL = 25     # ticks after a puncture that belong to its recoil, as in tests/public/changing/test_changes.c
LATE = 2000     # us; if two ticks are further apart, one has missed its period
NOTICED, NOTICED_LEAST = 0.07, 0.05     # just noticeable difference in force: as a fraction, and in N (tests/verification/verify_smoothness.c)


def check(good, what):
    if not good:
        raise SystemExit("FAILED: " + what)


def write_event(log, number, utime, channel, data):
    log.write(struct.pack(">IqqII", 0xEDA1DA01, number, utime, len(channel), len(data)) + channel + data)


def smooth(part):
    return part ** 3 * (10 + part * (6 * part - 15))


def write_motion(types, path, still, moving):
    """Writes a log with 1000 poses per second: the needle is pushed into the tissue and drawn back slightly within 3 s, rests for `still` s, moves back and
    forth by 4 mm for `moving` s, and rests for 2 s."""
    with open(path, "wb") as log:
        for i in range(int(1000 * (3 + still + moving + 2))):
            t = 1e-3 * i
            depth = -1e-3 + 0.045 * smooth(min(t / 2, 1.0)) - 3e-3 * smooth(min(max(t - 2, 0.0), 1.0))
            phase = min(max(t - 3 - still, 0.0), moving)
            depth += 2e-3 * (1 - math.cos(2 * math.pi * 0.5 * phase))    # at most 6.3 mm/s
            pose = types.needle_pose_t()
            pose.utime, pose.session, pose.seq, pose.wrench_tick = 1000000 + 1000 * i, 4711, i, -1
            pose.position, pose.orientation = (0.005, 0.003, depth - 0.2), (1, 0, 0, 0)
            write_event(log, i, pose.utime, b"TROCAR_POSE", pose.encode())


def random_moduli(chance):
    return {f"regions[{name}].youngs_modulus": given * 2.0 ** chance.uniform(-1, 1) for name, given in (("prostate", 60e3), ("surrounding", 30e3))}


def ask(client, values, seconds=0.0):
    check(client.change(values, seconds), "a change was pending")
    while client.reply()[0] is Answer.WAITING:
        time.sleep(0.0005)
    return client.reply()


def random_values(chance):
    """Returns values between a third and three times the scene's. Static and kinetic friction are scaled together, so that the moving shaft does not stick and
    slip."""
    scale = lambda: 3.0 ** chance.uniform(-1, 1)
    region, kind = chance.choice([("prostate", (15, 9, 0.3)), ("surrounding", (12, 7, 0.25))]), chance.randrange(4)
    name, (static, kinetic, cutting) = region
    if kind == 0:
        factor = scale()
        return {f"regions[{name}].friction.static": factor * static, f"regions[{name}].friction.kinetic": factor * kinetic}
    if kind == 1:
        return {f"regions[{name}].cutting_force": cutting * scale(), f"regions[{name}].cutting_viscosity": scale()}
    if kind == 2:
        return {f"regions[{name}].friction.viscous": 100 * scale()}
    return {"membranes[skin].puncture_force": 0.6 * scale(), "membranes[1].puncture_force": 0.9 * scale()}


BAD = (({"regions[prostate].poisson_ratio": 0.4}, "cannot change during a run"), ({"membranes[skin].puncture_force": -1}, "at least 0"),
       ({"membranes[bladder].puncture_force": 1}, "no such entry"), ({"membranes[skin].puncture_force": ".inf"}, "bone"),
       ({"regions[prostate].friction.kinetic": 1e6}, "static limit"), ({"regions[prostate].cutting_force": "soft"}, "at least 0"), ({}, "nothing to change"))


def record(path):
    """Writes the messages to an LCM log until the process is killed. Replaces lcm-logger, whose queue holds only 30 messages, so that it loses some on a busy
    machine."""
    channels = {f"TROCAR_{name}".encode() for name in ("POSE", "WRENCH", "TIMING", "VALUES", "CHANGE", "REPLY")}
    bus, number = lcm_socket(), 0
    bus.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    bus.settimeout(None)
    with open(path, "wb", buffering=0) as log:
        while True:
            channel, _, data = bus.recv(65536)[8:].partition(b"\0")
            if channel in channels:
                write_event(log, number, now(), channel, data)
                number += 1


def events(path):
    """Yields channel and data of each event in an LCM log."""
    data, at = path.read_bytes(), 0
    while at + 28 <= len(data):
        channel, size = (int.from_bytes(data[at + k:at + k + 4], "big") for k in (20, 24))
        yield data[at + 28:at + 28 + channel].decode(), data[at + 28 + channel:at + 28 + channel + size]
        at += 28 + channel + size


def missed(timing, spans):
    """Returns the numbers of ticks and of missed periods in these spans, given as pairs of wall-clock times (us), and the median of the compute time's p99
    (us)."""
    ticks = misses = 0
    compute = []
    for begin, end in spans:
        within = [m for m in timing if begin <= m.utime <= end]
        ticks += within[-1].ticks - within[0].ticks
        misses += within[-1].misses - within[0].misses
        compute += [m.compute_p99 for m in within]
    return ticks, misses, 1e6 * statistics.median(compute)


def largest_jump(wrenches, spans):
    """Returns the largest change in the model's force from tick to tick, in just noticeable differences, and the number of ticks that exceed one. The recoil of
    a puncture counts as part of the puncture. Ticks that came late, or whose poses did, are left out, because such a tick contains several periods of the
    hand's motion."""
    largest, noticed, since = 0.0, 0, 0
    for a, b in zip(wrenches, wrenches[1:]):
        since = 0 if b.tick != a.tick + 1 or b.events & b.EVENT_PUNCTURE else since + 1
        late = b.utime - a.utime > LATE or b.pose_seq - a.pose_seq > 2
        if since <= RECOIL or late or not any(begin <= b.utime <= end for begin, end in spans):
            continue
        jump = math.dist(a.raw_force, b.raw_force) / max(NOTICED_LEAST, NOTICED * math.hypot(*a.raw_force))
        largest = max(largest, jump)
        noticed += jump > 1.0
    return largest, noticed


def replay(poses, *arguments):
    done = subprocess.run([BUILD / "clients/trocar-replay", "--scene", SCENE, "--poses", poses, *arguments], capture_output=True, text=True, check=False)
    check(done.returncode in (0, 1), done.stderr)
    return done


def now():
    return time.time_ns() // 1000


def start_server():
    """Starts the server, with real-time priority if permitted."""
    for options in ([], ["--allow-non-rt"]):
        server = subprocess.Popen([BUILD / "server/trocar-server", "--scene", SCENE, *options], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        for line in server.stdout:
            if line == "ready\n":
                print("real time" if not options else "without real time")
                return server
        server.wait()
    raise SystemExit("FAILED: the server does not start")


def main(folder):
    folder = Path(folder)
    subprocess.run(["lcm-gen", "-p", "--ppath", folder, SOURCE / "lcmtypes/trocar.lcm"], check=True)
    sys.path.insert(0, str(folder))
    import trocar as types
    log = folder / "live.log"
    server = start_server()
    urgent = ["chrt", "--fifo", "60"] if subprocess.run(["chrt", "--fifo", "60", "true"], stderr=subprocess.DEVNULL, check=False).returncode == 0 else []
    recorder = subprocess.Popen([*urgent, sys.executable, __file__, *sys.argv[1:3], log])
    still = moving = 1.2 * 2 * 0.5 * CHANGES * (PERIOD + 4e-3) + MODULI * 6.0 + 3.0
    write_motion(types, folder / "motion.log", still, moving)
    other, chance, spans = trocar_client.Client(URL), random.Random(1), {}
    time.sleep(0.5)
    began = time.monotonic()
    hand = subprocess.Popen([*urgent, "lcm-logplayer", folder / "motion.log"], stdout=subprocess.DEVNULL)
    time.sleep(4.0)

    for values, words in BAD:
        answer, why = ask(other, values)
        check(answer is Answer.REFUSED and words in why, f"{values}: {answer}, {why}")
    refused_at = now()
    time.sleep(1.2)
    for moves in (False, True):
        time.sleep(max(0.0, began + 3.5 + (still if moves else 0.0) - time.monotonic()))
        for _ in range(10):     # runs with and without changes alternate, because the machine's load varies
            for changes in (False, True):
                begin = now()
                for _ in range(CHANGES // 20):
                    answer, why = ask(other, random_values(chance), 0.1) if changes else (Answer.DONE, "")
                    check(answer is Answer.DONE, why)
                    time.sleep(PERIOD)
                time.sleep(0.2)
                spans.setdefault((moves, changes), []).append((begin, now()))
        begin = now()
        for _ in range(MODULI):     # each change spends about a second building a model and another moving the stiffness
            answer, why = ask(other, random_moduli(chance), 0.3)
            check(answer is Answer.DONE, why)
        time.sleep(1.0)
        spans[moves, "moduli"] = [(begin, now())]
        check(time.monotonic() < began + 3 + still + (moving if moves else 0.0), "the changes take too long")
    check(hand.wait(still + moving) == 0, "the player failed")
    other.close()
    time.sleep(0.3)
    recorder.terminate()
    recorder.wait()
    server.terminate()
    check(server.wait(10) == 0, "the server failed")

    read = {name: [] for name in ("TROCAR_WRENCH", "TROCAR_TIMING", "TROCAR_VALUES", "TROCAR_CHANGE", "TROCAR_REPLY")}
    kinds = dict(zip(read, (types.needle_wrench_t, types.loop_timing_t, types.values_t, types.change_t, types.command_reply_t)))
    for channel, data in events(log):
        if channel in read:
            read[channel].append(kinds[channel].decode(data))
    original = [m.value for m in read["TROCAR_VALUES"] if m.utime < refused_at]
    check(original and all(m == original[0] for m in original), "refused changes had an effect")
    check(15.0 in original[0] and "regions[prostate].friction.static" in read["TROCAR_VALUES"][0].key, "the values are not those of the scene")
    check(read["TROCAR_VALUES"][-1].value != original[0], "the server does not show what has changed")
    done = sum(m.command == types.command_t.CHANGE and m.status == m.DONE for m in read["TROCAR_REPLY"])
    sent = CHANGES + 2 * MODULI
    check(done == sent and len(read["TROCAR_CHANGE"]) == sent + len(BAD), f"{done} changes done and %d sent in the log" % len(read["TROCAR_CHANGE"]))

    for moves in (False, True):
        results = {}
        for changes, words in ((False, "no changes"), (True, "500 changes"), ("moduli", f"{MODULI} changes of moduli")):
            ticks, misses, compute = missed(read["TROCAR_TIMING"], spans[moves, changes])
            results[changes] = ticks, misses, *largest_jump(read["TROCAR_WRENCH"], spans[moves, changes])
            print(f"{'moving' if moves else 'still'} needle, {words}: {misses} of {ticks} ticks missed, computing time p99 "
                  f"{compute:.0f} us, largest jump {results[changes][2]:.3f} of what is noticed, exceeded {results[changes][3]} times")
        usual = results[False][1] / results[False][0]   # fraction of the ticks
        for changes, words in ((True, "changes"), ("moduli", "changes of moduli")):
            ticks, misses, _, exceeded = results[changes]
            check(misses <= 2 * usual * ticks + 10, f"{words} make ticks late")
            check(exceeded == 0, "the force jumps")

    first = folder / "replayed.log"
    compared = replay(log, "--compare", log, "--tolerance", "10", "--out", first)
    print(compared.stderr)
    check(f"{sent + len(BAD)} changes" in compared.stderr, "the replay does not carry out the changes")
    again = replay(first, "--compare", first, "--tolerance", "0")
    check(again.returncode == 0, "a second replay differs: " + again.stderr)
    last = next(line for line in compared.stderr.splitlines() if " last: " in line)
    check(float(last.split("% of its peak")[0].split()[-1]) < 5.0, "the replay ends with another force: " + last)


if __name__ == "__main__":
    if sys.argv[3:]:
        record(sys.argv[3])
    with tempfile.TemporaryDirectory() as made:
        main(made)
