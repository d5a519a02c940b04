#!/usr/bin/python3
"""Measures how long trocar-slicer takes and what it does to the haptic loop, in a private network. Run it by hand:

    scripts/netns tests/slicer/measure.py BUILD_DIR SCENE [SECONDS [ROUNDS [STREAMED]]]

One server, and one device that plays figure 8, run throughout. If another scene, STREAMED, is given, the bridge shows that one instead, and a stand-in for
its server sends 30 frames per second on another LCM port, because a real server sends fewer frames of such a large mesh. Rounds without the bridge alternate
with rounds with the bridge and two clients, one of which never reads. They alternate because other load on the machine also changes the loop's times. The
medians of the rounds are compared.
"""
import os
import signal
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time
from collections import Counter

PORT = 18944
STREAM = "udpm://239.255.76.67:7668?ttl=0"


def start(command, **environment):
    """Starts a program and waits until it prints "ready"."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=os.environ | environment)
    for line in process.stdout:
        if line == "ready\n":
            threading.Thread(target=process.stdout.read, daemon=True).start()
            return process
    sys.exit(f"{command[0]}: status {process.wait()}")


class Timing:
    """Receives the server's TROCAR_TIMING messages: ten per second, each with the percentiles of the last 100 ms."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(("", 7667))
        group = struct.pack("4s4s", socket.inet_aton("239.255.76.67"), socket.inet_aton("127.0.0.1"))
        self.socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        self.values = []
        threading.Thread(target=self.listen, daemon=True).start()

    def listen(self):
        while True:
            packet = self.socket.recv(65536)
            if packet[:4] == b"LC02" and packet[8:22] == b"TROCAR_TIMING\0":
                fields = struct.unpack(">qqd6d", packet[30:30 + 72])    # utime, ticks, rate; then p50, p99 and maximum of lateness and of compute time
                self.values.append({"lateness": fields[4], "compute": fields[7], "compute p50": fields[6]})

    def medians(self, seconds):
        self.values.clear()
        time.sleep(seconds)
        return {key: 1e6 * statistics.median(value[key] for value in self.values) for key in self.values[0]}


class Reader:
    """A client that reads everything it receives."""

    def __init__(self):
        self.connection = socket.create_connection(("127.0.0.1", PORT))
        self.counts, self.bytes, self.ages = Counter(), 0, []
        threading.Thread(target=self.read, daemon=True).start()

    def read(self):
        stream = self.connection.makefile("rb", buffering=1 << 20)
        while len(head := stream.read(58)) == 58:
            _, _, name, stamp, size, _ = struct.unpack(">H12s20sQQQ", head)
            if len(stream.read(size)) < size:
                break
            name = name.strip(b"\0").decode()
            self.counts[name] += 1
            self.bytes += 58 + size
            if name == "NeedleTipToReference":
                self.ages.append(time.time() - stamp / 2**32)


def processor_seconds(pid):
    with open(f"/proc/{pid}/stat") as file:
        fields = file.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def with_bridge(build, scene, streamed, timing, seconds):
    bridge = start([f"{build}/clients/bridges/slicer/trocar-slicer", "--scene", streamed or scene, *(["--lcm-url", STREAM] if streamed else [])])
    reader, slow = Reader(), socket.create_connection(("127.0.0.1", PORT))
    time.sleep(1)
    reader.counts.clear()
    reader.ages.clear()
    reader.bytes, used = 0, processor_seconds(bridge.pid)
    times = timing.medians(seconds)
    used = processor_seconds(bridge.pid) - used
    ages = sorted(reader.ages)
    times |= {"bridge, % of a core": 100 * used / seconds, "MB/s to a client": 1e-6 * reader.bytes / seconds, "needle age p50, ms": 1e3 * ages[len(ages) // 2],
              "needle age p99, ms": 1e3 * ages[len(ages) * 99 // 100]}
    times |= {f"{name}, 1/s": count / seconds for name, count in reader.counts.items()}
    reader.connection.close()
    slow.close()
    bridge.send_signal(signal.SIGTERM)
    bridge.wait()
    return times


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    build, scene, seconds, rounds = sys.argv[1], sys.argv[2], float(sys.argv[3] if len(sys.argv) > 3 else 8), int(sys.argv[4] if len(sys.argv) > 4 else 9)
    streamed = sys.argv[5] if len(sys.argv) > 5 else None
    server = start([f"{build}/server/trocar-server", "--scene", scene, "--allow-non-rt"])
    device = subprocess.Popen([f"{build}/clients/trocar-device", "--script", "figure8", "--duration", "1e5"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    others = [device, server]
    if streamed:
        others.append(start([f"{build}/tests/slicer/test_slicer", "-", "-", streamed, "stream"], LCM_DEFAULT_URL=STREAM))
    timing, without, having = Timing(), [], []
    time.sleep(3)
    for _ in range(rounds):
        without.append(timing.medians(seconds))
        having.append(with_bridge(build, scene, streamed, timing, seconds))
    for process in others:
        process.terminate()
        process.wait()
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    for key in having[0]:
        value = statistics.median(run[key] for run in having)
        if key in without[0]:
            base = statistics.median(run[key] for run in without)
            print(f"{key + (' p99' if 'p50' not in key else '')}, us: without {base:.1f}, with {value:.1f}, ratio {value / base:.2f}")
        else:
            print(f"{key}: {value:.1f}")


main()
