"""A driver process for an arm, as proto/flip/bench/v1/arm.proto asks for. docs/tutorials/your-own-arm.md runs it.

One event loop does everything: a robot's blocking calls belong on a thread of their own, or renewals wait for them and the
dead-man acts too early.
"""

import asyncio
import sys
import time
import uuid

import arm_pb2 as pb
import arm_pb2_grpc
import grpc
from grpc import StatusCode
from robot import LIMITS, Robot

DEAD_MAN_S = 0.3
SOMEWHERE = (pb.STATION_OVER_VIAL, pb.STATION_RETRACTED)


class Arm(arm_pb2_grpc.ArmServicer):
    def __init__(self):
        self.robot, self.mode, self.last_shake = Robot(), pb.MODE_IDLE, None
        self.lease, self.renewed, self.stopped = None, 0.0, False
        self.latch_cause, self.last, self.task = "", None, None

    # ---- motions ---------------------------------------------------------------------------------------------------
    async def move(self, request, context, work, stations=SOMEWHERE):
        """Check in the contract's order, then carry out `work`, or give the first answer again."""
        ticket, wanted = request.ticket, (type(request), getattr(request, "pitch_deg", getattr(request, "amplitude_mm", 0)))
        if not request.HasField("ticket"):
            await context.abort(StatusCode.INVALID_ARGUMENT, "ticket: must be set")
        await self.held(ticket.lease_id, context)
        if ticket.sequence == 0:
            await context.abort(StatusCode.INVALID_ARGUMENT, "sequence: must be 1 or more")
        if self.last and ticket.sequence <= self.last[0]:
            if self.last[:2] != (ticket.sequence, wanted):
                await context.abort(StatusCode.ALREADY_EXISTS, "this sequence number was used for another motion")
        else:
            if self.mode != pb.MODE_READY and not (self.mode == pb.MODE_STOPPED and wanted[0] is pb.RetractRequest):
                await context.abort(StatusCode.FAILED_PRECONDITION, "stopped or busy: retract, or wait")
            if self.robot.station not in stations:
                await context.abort(StatusCode.FAILED_PRECONDITION, "not from here: retract first")
            self.mode, self.task = pb.MODE_MOVING, asyncio.create_task(self.carry_out(ticket.sequence, wanted, work))
            self.last = (ticket.sequence, wanted, self.task)
        await asyncio.wait([self.last[2]])  # a motion goes on when its caller has gone
        if self.last[2].cancelled():
            await context.abort(StatusCode.ABORTED, "Stop, Release or the dead-man ended the motion")
        if self.last[2].exception():
            await context.abort(StatusCode.INTERNAL, f"the robot failed: {self.last[2].exception()}"[:200])
        return self.last[2].result()

    async def carry_out(self, sequence, wanted, work):
        began = time.monotonic()
        try:
            shaken = await work() or {}
        except Exception as error:
            self.lease, self.mode, self.latch_cause = None, pb.MODE_LATCHED, f"the robot failed: {error}"[:200]
            raise
        done = pb.Executed(sequence=sequence, duration_s=time.monotonic() - began, pitch_deg=self.robot.pitch_deg, **shaken)
        self.last_shake = done if wanted[0] is pb.ShakeRequest else self.last_shake
        self.mode = pb.MODE_STOPPED if self.stopped else pb.MODE_READY
        return done

    async def held(self, lease_id, context):
        if self.mode == pb.MODE_LATCHED:
            await context.abort(StatusCode.FAILED_PRECONDITION, f"latched: {self.latch_cause}")
        if self.lease is None or self.lease != lease_id:
            await context.abort(StatusCode.PERMISSION_DENIED, "this lease has ended or never was: acquire the arm")

    async def bounded(self, context, value, lower, upper):
        if not lower <= value <= upper:  # nor is NaN
            await context.abort(StatusCode.INVALID_ARGUMENT, f"must be from {lower} to {upper}")

    async def bring_back(self, then, cause=""):
        """RETURNING: end what moves and whose lease it was, level, retract."""
        if self.task:
            self.task.cancel()
        self.lease, self.mode = None, pb.MODE_RETURNING
        try:
            await self.robot.home()
            self.mode, self.latch_cause = then, cause
        except Exception as error:
            self.mode, self.latch_cause = pb.MODE_LATCHED, f"the spoon could not be brought back: {error}"[:200]
            raise

    async def returned(self, context):
        """Bring the spoon back for a caller, who may go meanwhile."""
        try:
            await asyncio.shield(asyncio.create_task(self.bring_back(pb.MODE_IDLE)))
        except Exception as error:
            await context.abort(StatusCode.INTERNAL, f"the spoon could not be brought back: {error}"[:200])

    async def watch_over(self):
        """The dead-man."""
        while True:
            await asyncio.sleep(0.01)
            if self.lease and time.monotonic() - self.renewed > DEAD_MAN_S:
                await asyncio.wait([asyncio.create_task(self.bring_back(pb.MODE_LATCHED, "nobody renewed the lease in time"))])

    # ---- the calls -------------------------------------------------------------------------------------------------
    async def Describe(self, request, context):
        return pb.Description(protocol_version=1, name="Python example", serial="NONE", driver_version="1", limits=LIMITS,
                              is_emulated=True, latch_cause=self.latch_cause)

    async def Acquire(self, request, context):
        if self.mode == pb.MODE_LATCHED:
            await context.abort(StatusCode.FAILED_PRECONDITION, f"latched: {self.latch_cause}")
        if self.mode != pb.MODE_IDLE:
            await context.abort(StatusCode.RESOURCE_EXHAUSTED, "somebody else has control of the arm")
        self.lease, self.renewed, self.stopped = uuid.uuid4().hex, time.monotonic(), False
        self.mode, self.last = pb.MODE_READY, None
        return pb.Lease(lease_id=self.lease, dead_man_ms=int(DEAD_MAN_S * 1000))

    async def Renew(self, request, context):
        await self.held(request.lease_id, context)
        self.renewed = time.monotonic()
        return pb.RenewResponse(mode=self.mode)

    async def Release(self, request, context):
        await self.held(request.lease_id, context)
        await self.returned(context)
        return pb.ReleaseResponse()

    async def Recover(self, request, context):
        if self.mode not in (pb.MODE_IDLE, pb.MODE_LATCHED):
            await context.abort(StatusCode.FAILED_PRECONDITION, "the arm is not latched")
        if self.mode == pb.MODE_LATCHED:
            await self.returned(context)
        return pb.RecoverResponse()

    async def Stop(self, request, context):
        if self.lease:
            self.stopped, self.mode = True, pb.MODE_STOPPED
            if self.task:
                self.task.cancel()
        return pb.StopResponse()

    async def Approach(self, request, context):
        level = (self.robot.pitch_deg, self.robot.shake_mm) == (0.0, 0.0)
        return await self.move(request, context, self.robot.approach, SOMEWHERE if level else (pb.STATION_OVER_VIAL,))

    async def Retract(self, request, context):
        return await self.move(request, context, self.robot.home, pb.Station.values())

    async def Pitch(self, request, context):
        await self.bounded(context, request.pitch_deg, LIMITS.pitch_deg_min, LIMITS.pitch_deg_max)
        return await self.move(request, context, lambda: self.robot.turn(request.pitch_deg))

    async def Shake(self, request, context):
        await self.bounded(context, request.amplitude_mm, 0.0, LIMITS.shake_mm_max)
        return await self.move(request, context, lambda: self.robot.shake(request.amplitude_mm))

    async def StreamState(self, request, context):
        while True:
            it = self.robot
            yield pb.State(mode=self.mode, station=it.station, pitch_deg=it.pitch_deg, shake_displacement_mm=it.shake_mm,
                           last_shake=self.last_shake, measured_at_s=time.monotonic())
            await asyncio.sleep(0.005 if self.mode != pb.MODE_IDLE else 0.05)


async def serve(port):
    # FLIP pings each connection every second, also when nothing else is said; by default a server of grpcio hangs up on that.
    options = [("grpc.http2.min_ping_interval_without_data_ms", 500), ("grpc.http2.max_ping_strikes", 0),
               ("grpc.keepalive_permit_without_calls", 1)]
    arm, server = Arm(), grpc.aio.server(options=options)
    arm_pb2_grpc.add_ArmServicer_to_server(arm, server)
    server.add_insecure_port(f"127.0.0.1:{port}")
    await server.start()
    print(f"driver on http://127.0.0.1:{port}", flush=True)
    await asyncio.gather(arm.watch_over(), server.wait_for_termination())


asyncio.run(serve(int(sys.argv[1])))
