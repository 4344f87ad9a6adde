"""What the client of `sila2` does. Runs where it is installed, and prints one JSON document."""

import json
import sys
import time
import uuid
import warnings

from sila2.client import SilaClient
from sila2.client.client_observable_command_instance import ClientObservableCommandInstanceWithIntermediateResponses
from sila2.framework import DefinedExecutionError, FrameworkError, UndefinedExecutionError, ValidationError

POWDER = "sand"


def error(ex):
    said = {"kind": type(ex).__name__, "message": str(ex)}
    if isinstance(ex, DefinedExecutionError):
        said["identifier"] = str(ex.fully_qualified_identifier)
    if isinstance(ex, ValidationError):
        parameter = ex.parameter_fully_qualified_identifier
        said["parameter"] = str(getattr(parameter, "fully_qualified_identifier", parameter))
    return said


def attempt(call):
    try:
        return {"value": call()}
    except (DefinedExecutionError, FrameworkError, UndefinedExecutionError, ValidationError) as ex:
        return {"error": error(ex)}


def dose(client, key, target=15.0, powder=POWDER, metadata=None):
    more = {} if metadata is None else {"metadata": metadata}
    return client.PowderWeighing.DosePowder(
        Powder=powder, TargetMass=target, LowerTolerance=5.0, UpperTolerance=5.0, Vial="", Lot="lot 7", Operator="Ada", VialCheck="Skip", DoseIdentifier=key, **more)


def wait(instance, seconds=240):
    seen, end = [], time.monotonic() + seconds
    while not instance.done and time.monotonic() < end:
        if instance.progress is not None:
            seen.append(instance.progress)
        time.sleep(0.02)
    return seen


def outcome(instance):
    try:
        return {"value": instance.get_responses()._asdict()}
    except (DefinedExecutionError, FrameworkError, UndefinedExecutionError, ValidationError) as ex:
        return {"error": error(ex)}


def again(client, execution):
    """An execution of which only the UUID is known, as after a restart of the scheduler."""
    return ClientObservableCommandInstanceWithIntermediateResponses(client, client.PowderWeighing.DosePowder, uuid.UUID(execution))


def who(client):
    service = client.SiLAService
    return {
        "name": service.ServerName.get(), "uuid": service.ServerUUID.get(), "type": service.ServerType.get(), "version": service.ServerVersion.get(),
        "url": service.ServerVendorURL.get(), "features": [str(it) for it in service.ImplementedFeatures.get()]}


def do_who(client):
    return who(client)


def do_dose(client, key, target="15"):
    instance = dose(client, key, float(target))
    with instance.subscribe_to_intermediate_responses() as values:
        masses = [(value.Mass, value.State) for value in values]
    wait(instance)
    return {"uuid": str(instance.execution_uuid), "status": instance.status.name, "progress": instance.progress, "values": masses, **outcome(instance)}


def do_begin(client, key, target="15"):
    """Begins a dose and returns once powder falls."""
    instance = dose(client, key, float(target))
    with instance.subscribe_to_intermediate_responses() as values:
        for value in values:
            if value.State == "dosing" and value.Step > 0:
                break
    return {"uuid": str(instance.execution_uuid), "state": value.State}


def do_cancel(client, key, target):
    instance = dose(client, key, float(target))
    with instance.subscribe_to_intermediate_responses() as values:
        for value in values:
            if value.State == "dosing" and value.Step > 0:
                client.CancelController.CancelCommand(CommandExecutionUUID=str(instance.execution_uuid))
                break
    wait(instance)
    client.CancelController.CancelCommand(CommandExecutionUUID=str(instance.execution_uuid))
    return {"status": instance.status.name, "bench": client.BenchControl.State.get(), **outcome(instance)}


def do_look(client, execution):
    """State and result of an execution that somebody else began."""
    instance = again(client, execution)
    wait(instance, 30)
    found = client.PowderWeighing.GetWeighing(CommandExecutionUUID=execution)
    bench = client.BenchControl.Bench.get()
    return {"status": instance.status.name, "outcome": found.Outcome, "bench": bench._asdict(), **outcome(instance)}


def do_errors(client):
    unknown = str(uuid.uuid4())
    return {
        "powder": attempt(lambda: str(dose(client, "e1", powder="no such powder").execution_uuid)),
        "target": attempt(lambda: str(dose(client, "e2", target=1e6).execution_uuid)),
        "key": attempt(lambda: str(dose(client, "").execution_uuid)),
        "uncalibrated": attempt(lambda: str(dose(client, "e3", powder="salt").execution_uuid)),
        "cancel": attempt(lambda: client.CancelController.CancelCommand(CommandExecutionUUID=unknown)),
        "feature": attempt(lambda: client.SiLAService.GetFeatureDefinition("org.silastandard/core/Nothing/v1")),
        "looked": attempt(lambda: client.BenchControl.Clear(Person="Ada", Note="", Looked=False, VialReady=True, Resume=False)),
        "resume": attempt(lambda: client.BenchControl.Resume(Person="Ada", Note="")),
    }


def do_attempt(client, key, target="15", powder=POWDER):
    return attempt(lambda: str(dose(client, key, float(target), powder).execution_uuid))


def do_bench(client):
    reading = client.BalanceReading.Reading.get()
    return {"state": client.BenchControl.State.get(), "bench": client.BenchControl.Bench.get()._asdict(), "reading": reading._asdict(),
            "powders": client.PowderWeighing.Powders.get()}


def do_balance(client):
    def asked(name):
        return attempt(lambda: getattr(client.BalanceReading, name)()._asdict())
    return {name: asked(name) for name in ("Read", "Tare", "Zero")} | {"after": asked("Read")}


def do_stop(client):
    stopped = client.BenchControl.Stop(Person="Ada").State
    return {"stopped": stopped, "resumed": client.BenchControl.Resume(Person="Ada", Note="").State}


def do_certificate(client, execution):
    return {"page": client.PowderWeighing.GetCertificate(CommandExecutionUUID=execution).Certificate.decode()[:4000]}


def do_calibrate(client):
    # As the calibration of the data folder: the same specification is the same job, which has a result.
    instance = client.PowderCalibration.Calibrate(Powder=POWDER, Method="sequential", Sets=2, Tolerance=5.0, Particles=400, TrialsMax=60, Seed=0)
    wait(instance)
    found = instance.get_responses()
    return {"status": instance.status.name, "progress": instance.progress, "sets": found.Sets, "reached": found.Reached}


def do_measure(client, piles="1"):
    def measured():
        instance = client.AngleOfReposeMeasurement.MeasureAngleOfRepose(Powder=POWDER, Run=0, Piles=int(piles), Frames=0)
        with instance.subscribe_to_intermediate_responses() as values:
            said = [value.Message for value in values]
        wait(instance)
        found = instance.get_responses()
        frame = client.AngleOfReposeMeasurement.GetFrame(CommandExecutionUUID=str(instance.execution_uuid), Pile=1, Frame=1, Part="depth").Content
        return {"angle": found.AngleOfRepose, "piles": found.Piles, "said": len(said), "frame": len(frame)}
    return attempt(measured)


def do_investigate(client, rows):
    """A campaign over 2 MiB travels as a binary of its own."""
    def investigated():
        campaign = open(rows, "rb").read()
        instance = client.SimulatorDiscovery.Investigate(Campaign=campaign, Simulations=99, Heaps=0, Seed=1)
        wait(instance)
        found = instance.get_responses()
        return {"bytes": len(campaign), "verdict": found.Verdict, "sentence": found.Sentence, "report": json.loads(found.Report)["verdict"]}
    return {**attempt(investigated), "simulator": client.SimulatorDiscovery.Simulator.get()}


def do_login(client, user, token):
    server = client.SiLAService.ServerUUID.get()
    login = client.AuthenticationService.Login
    wrong = attempt(lambda: login(user, "flip_0_0", server, [])._asdict())
    got = login(user, token, server, [])
    access = client.AuthorizationService.AccessToken
    before = attempt(lambda: str(dose(client, "login-1").execution_uuid))
    instance = dose(client, "login-1", metadata=[access(got.AccessToken)])
    wait(instance)
    ended = outcome(instance)
    invalid = attempt(lambda: str(dose(client, "login-2", metadata=[access("nothing")]).execution_uuid))
    client.AuthenticationService.Logout(got.AccessToken)
    after = attempt(lambda: str(dose(client, "login-2", metadata=[access(got.AccessToken)]).execution_uuid))
    affected = [str(it) for it in access.get_affected_calls()]
    return {"wrong": wrong, "before": before, "ended": ended, "invalid": invalid, "after": after, "lifetime": got.TokenLifetime, "affected": affected}


def do_lock(client):
    lock = client.LockController
    lock.LockServer("mine", 60)
    twice = attempt(lambda: lock.LockServer("yours", 60))
    locked = lock.IsLocked.get()
    without = attempt(lambda: str(dose(client, "lock-1").execution_uuid))
    instance = dose(client, "lock-1", metadata=[lock.LockIdentifier("mine")])
    wait(instance)
    ended = outcome(instance)
    wrong = attempt(lambda: lock.UnlockServer("yours"))
    lock.UnlockServer("mine")
    return {"twice": twice, "locked": locked, "without": without, "ended": ended, "wrong": wrong, "after": lock.IsLocked.get()}


def main():
    what, host, port, *more = sys.argv[1:]
    warnings.simplefilter("ignore")
    if what == "discover":
        client = SilaClient.discover(server_uuid=host, timeout=20)
    elif what == "tls":
        client, what = SilaClient(host, int(port), root_certs=open(more[0], "rb").read()), "who"
        more = []
    else:
        client = SilaClient(host, int(port), insecure=True)
    said = who(client) if what == "discover" else globals()[f"do_{what}"](client, *more)
    print(json.dumps(said, default=str), flush=True)
    client.close()


main()
