"""A robot that is not there: two numbers that follow smooth motions. Replace this file by your own robot's."""

import asyncio
import math
import time

import arm_pb2 as pb

LIMITS = pb.Limits(pitch_deg_min=-10, pitch_deg_max=50, pitch_deg_s_max=30, shake_mm_max=16,
                   velocity_m_s_max=0.75, acceleration_m_s2_max=1.17, jerk_m_s3_max=225)
TRAVEL_S = 1.0


def smooth(share):
    """From 0 to 1, at rest at both ends, with the least jerk. Its peaks: 1.875 in speed, 5.77 in acceleration, 60 in jerk."""
    return share**3 * (10 - 15 * share + 6 * share**2)


class Robot:
    """Every motion is a coroutine. Cancelled, it must stand still within 50 ms, where it is."""

    def __init__(self):
        self.station, self.pitch_deg, self.shake_mm = pb.STATION_RETRACTED, 0.0, 0.0

    async def follow(self, seconds, pose):
        """Be at pose(0), ..., pose(1)."""
        began, share = time.monotonic(), 0.0
        while share < 1:
            await asyncio.sleep(0.004)
            share = min(1.0, (time.monotonic() - began) / seconds)
            self.pitch_deg, self.shake_mm = pose(share)

    async def turn(self, to_deg):
        """To this pitch; a stroke that Stop left half-way is taken back on the way."""
        from_deg, from_mm = self.pitch_deg, self.shake_mm
        if (to_deg, 0.0) != (from_deg, from_mm):
            seconds = max(0.1, 1.875 * abs(to_deg - from_deg) / LIMITS.pitch_deg_s_max)
            await self.follow(seconds, lambda t: (from_deg + (to_deg - from_deg) * smooth(t), from_mm * (1 - smooth(t))))

    async def travel(self, to):
        if self.station != to:
            self.station = pb.STATION_BETWEEN
            await self.follow(TRAVEL_S, lambda _: (self.pitch_deg, self.shake_mm))
            self.station = to

    async def approach(self):
        await self.travel(pb.STATION_OVER_VIAL)

    async def home(self):
        await self.turn(0.0)
        await self.travel(pb.STATION_RETRACTED)

    async def shake(self, mm):
        """Out and back. What was executed: here what was asked for; of a real robot what it measured."""
        m, pitch_deg = mm * 1e-3, self.pitch_deg
        seconds = max(1.875 * m / LIMITS.velocity_m_s_max, math.sqrt(5.77 * m / LIMITS.acceleration_m_s2_max),
                      (60 * m / LIMITS.jerk_m_s3_max) ** (1 / 3))
        if seconds == 0:
            return {}
        await self.follow(2 * seconds, lambda t: (pitch_deg, mm * smooth(1 - abs(1 - 2 * t))))
        return {"amplitude_mm": mm, "peak_speed_m_s": 1.875 * m / seconds}
