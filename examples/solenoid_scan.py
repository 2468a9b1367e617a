"""Scan a solenoid and watch the beam, with the machine's plain topics alone: std_msgs, no action, no type of ours.

    awa_sim --ros-args -p speed:=100.0
    python examples/solenoid_scan.py

Prints the width and height of the beam on the screen, each the mean of some shots, for a few currents of K2.
"""

import math
import statistics
import time
from collections.abc import Callable
from functools import partial

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool, Float64

DEVICE, CURRENTS = "K2", (200.0, 215.0, 230.0, 245.0, 260.0)  # [A]
SEEN = ("sigma_x", "sigma_y")  # [mm]
SHOTS, SKIPPED = 5, 2  # the first may still be from the way there
TIMEOUT = 60.0  # of a step of the scan [s]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Scan(Node):
    """Moves one device, and keeps what it and the beam say."""

    def __init__(self) -> None:
        """Join the topics."""
        super().__init__("solenoid_scan")
        self.setpoint = self.create_publisher(Float64, f"{DEVICE}/setpoint", 10)
        self.readback = math.nan
        self.settled = False
        self.shots: dict[str, list[float]] = {name: [] for name in SEEN}
        self.create_subscription(Float64, f"{DEVICE}/readback", self.keep_readback, 10)
        self.create_subscription(Bool, f"{DEVICE}/settled", self.keep_settled, LATCHED)
        for name in SEEN:
            self.create_subscription(Float64, f"beam/{name}", partial(self.keep_shot, name), 100)

    def keep_shot(self, name: str, message: Float64) -> None:
        """Keep a shot of a diagnostic."""
        self.shots[name].append(message.data)

    def keep_readback(self, message: Float64) -> None:
        """Keep where the device is."""
        self.readback = message.data

    def keep_settled(self, message: Bool) -> None:
        """Keep whether it rests there."""
        self.settled = message.data

    def wait(self, condition: Callable[[], object]) -> None:
        """Spin until a condition holds."""
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            if time.monotonic() > deadline:
                raise SystemExit(f"the machine did not answer within {TIMEOUT:g} s")
            rclpy.spin_once(self, timeout_sec=0.1)

    def measure(self, current: float) -> dict[str, float]:
        """Go to a current, let it settle, and average the shots after that."""
        self.setpoint.publish(Float64(data=current))
        self.wait(lambda: self.settled and abs(self.readback - current) < 0.5)
        for shots in self.shots.values():
            shots.clear()
        enough = SKIPPED + SHOTS
        self.wait(lambda: all(len(shots) >= enough for shots in self.shots.values()))
        return {name: mean_of_valid(shots[SKIPPED:]) for name, shots in self.shots.items()}


def mean_of_valid(shots: list[float]) -> float:
    """Return the mean of the shots that were measured; NaN if none was."""
    return statistics.fmean([shot for shot in shots if not math.isnan(shot)] or [math.nan])


def main() -> None:
    """Scan."""
    rclpy.init()
    scan = Scan()
    try:
        scan.wait(lambda: scan.setpoint.get_subscription_count() and not math.isnan(scan.readback))
        for current in CURRENTS:
            beam = scan.measure(current)
            values = "  ".join(f"{name} = {value:.2f} mm" for name, value in beam.items())
            print(f"{DEVICE} = {scan.readback:.1f} A  {values}", flush=True)
    finally:
        scan.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
