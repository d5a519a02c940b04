"""A simulated device (../stability/simulated_device.h), connected through the stand-in for the Haply Inverse Service."""
import ctypes
import time

from standin import Service


class Vector(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in "xyz"]

    def __iter__(self):
        return iter((self.x, self.y, self.z))


class Properties(ctypes.Structure):
    """Mass (kg), damping (N s/m) and stiffness (N/m) at the handle, and the device's delay (s, each way), period (s) and resolution (m)."""
    _fields_ = [(name, ctypes.c_double) for name in ("mass", "damping", "stiffness", "delay", "period", "resolution")]


class Device:
    def __init__(self, build, properties, position):
        self.library = ctypes.CDLL(f"{build}/tests/haply/libsimulated_device.so")
        self.library.device_size.restype = ctypes.c_size_t
        self.library.device_read.restype = Vector
        self.library.device_swing.restype = ctypes.c_double
        self.state = ctypes.create_string_buffer(self.library.device_size())
        self.library.device_init(self.state, ctypes.byref(properties), Vector(*position), ctypes.c_double(time.monotonic()))

    def push(self, velocity, seconds):
        now = time.monotonic()
        self.library.device_push(self.state, Vector(*velocity), ctypes.c_double(now), ctypes.c_double(now + seconds))

    def apply(self, now, force):
        self.library.device_apply(self.state, ctypes.c_double(now), Vector(*force))

    def read(self, now):
        return tuple(self.library.device_read(self.state, ctypes.c_double(now)))

    def watch(self):
        self.library.device_watch(self.state)

    def swing(self):
        return self.library.device_swing(self.state)


class DeviceService(Service):
    """Applies the received forces to a device and reports its position."""

    def __init__(self, device, **service):
        self.held = device
        super().__init__(**service)
        self.position = device.read

    def take(self, message, fresh):
        count = len(self.forces)
        super().take(message, fresh)
        for at, force, _ in self.forces[count:]:
            self.held.apply(at, force)
