"""Runs server, bridge and stand-in for tests, in a private network namespace."""
import bisect
import collections
import gc
import math
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "shared"))
from simulated_device import DeviceService
from standin import Service, use_realtime

gc.disable()    # garbage collection pauses would look like pauses of the bridge


def wait_for(condition, what, seconds=5.0):
    end = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"timed out after {seconds} s: {what}")
        time.sleep(0.002)
    return found


class Wrenches:
    """Records when the server's wrenches arrive, as time-stamped by the kernel, in seconds of time.monotonic. (A process that has been sent SIGSTOP may go on
    running for a few milliseconds until it is scheduled.)"""

    SO_TIMESTAMPNS = 35

    def __init__(self, realtime):
        self.realtime = realtime
        self.times = collections.deque(maxlen=2000)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.setsockopt(socket.SOL_SOCKET, self.SO_TIMESTAMPNS, 1)
        self.socket.bind(("", 7667))
        self.socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton("239.255.76.67") + socket.inet_aton("0.0.0.0"))
        threading.Thread(target=self.listen, daemon=True).start()

    def listen(self):
        if self.realtime:
            use_realtime()
        while True:
            data, ancillary, _, _ = self.socket.recvmsg(65536, 64)
            if data[8:22] == b"TROCAR_WRENCH\0":
                seconds, nanoseconds = struct.unpack("qq", ancillary[0][2])
                self.times.append(seconds + 1e-9 * nanoseconds + time.monotonic() - time.time())

    def newest(self, before):
        """Returns the time of the newest wrench before this time, or -inf if there is none."""
        times = list(self.times)
        k = bisect.bisect_left(times, before)
        return times[k - 1] if k > 0 else -math.inf


class Rig:
    def __init__(self, build, source, folder, realtime=False, device=None, **service):
        """`device`: a simulated device (simulated_device.py) that feels the force. Without one, the test sets the positions."""
        self.build, self.source, self.folder = Path(build), Path(source), Path(folder)
        # The test sets the stand-in's positions, so there is no closed loop to stabilise, and a coupling would only make the force depend on the delay.
        figure8 = (self.source / "meshes/figure8.yaml").read_text().replace("mesh: ", f"mesh: {self.source.resolve()}/meshes/", 1)
        self.scene = self.folder / "scene.yaml"
        self.scene.write_text(figure8 + "device: {max_stiffness: .inf}\n")
        self.service = DeviceService(device, realtime=realtime, **service) if device else Service(realtime=realtime, **service)
        self.wrenches = Wrenches(realtime)
        self.bridge = self.server = None

    def start_server(self):
        log = open(self.folder / "server", "w+")
        self.server = subprocess.Popen([self.build / "server/trocar-server", "--scene", self.scene, "--allow-non-rt"], stdout=log, stderr=subprocess.STDOUT)
        wait_for(lambda: re.search("^ready$", Path(log.name).read_text(), re.MULTILINE), "the server is not ready", 20)

    def start_bridge(self, *options):
        self.out, self.said_file = self.folder / "bridge.out", self.folder / "bridge.err"
        self.bridge = subprocess.Popen([self.build / "clients/bridges/haply/trocar-haply", "--service", f"127.0.0.1:{self.service.port}", "--events", "0",
                                        *options], stdout=open(self.out, "w"), stderr=open(self.said_file, "w"))
        wait_for(lambda: self.service.forces, "the bridge sends nothing: " + self.said())

    def said(self):
        return self.said_file.read_text()

    def stop_bridge(self):
        self.bridge.send_signal(signal.SIGTERM)
        return self.bridge.wait(10)

    def kill_server(self):
        self.server.kill()
        self.server.wait()

    def end(self):
        for process in (self.bridge, self.server):
            if process and process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.terminate()
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    process.kill()
        self.service.stop()

    def force(self):
        """Returns the newest force (N) in the device's frame."""
        return self.service.forces[-1][1]

    def since(self, start):
        """Returns the pairs (time, force) received after this time."""
        forces, k = self.service.forces, len(self.service.forces)
        while k > 0 and forces[k - 1][0] >= start:
            k -= 1
        return [(at, force) for at, force, _ in forces[k:]]

    def norms_since(self, start):
        return [math.hypot(*force) for _, force in self.since(start)]

    def force_without_server(self, begin, end):
        """Returns the time (s) from the last wrench of a server that stopped shortly after `begin` to the last force before `end`."""
        last_wrench = self.wrenches.newest(end)
        assert begin - 0.1 < last_wrench < end - 0.1, "the server did not stop"
        return max((at for at, force in self.since(last_wrench) if force != (0, 0, 0) and at < end), default=last_wrench) - last_wrench

    def wait_for_force(self, least, what):
        return wait_for(lambda: math.hypot(*self.force()) > least, f"{what}: {self.force()} N; {self.said()}")
