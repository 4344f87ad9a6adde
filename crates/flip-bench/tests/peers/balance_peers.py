"""Balance simulators and clients by others, for tests/balance_peers.rs.

balance_peers.py install FOLDER        a virtual environment with requirements.txt; says where its python is, or why there is none
balance_peers.py serve KIND            their simulator on a TCP port; KIND is mt_sics, sbi or sbi16 (frames without identification)
balance_peers.py client KIND ADDRESS … their client reads, tares and reads again, on each balance; a line of JSON for each

`serve` hears orders on stdin: `load GRAMS` puts that on the pan, `adjust` starts an internal adjustment. It ends with stdin.
"""

import json
import pathlib
import socket
import subprocess
import sys
import threading

REQUIREMENTS = pathlib.Path(__file__).with_name("requirements.txt")
# Enough for the first download over a slow line.
INSTALL_S_MAX = 400


def install(folder: pathlib.Path) -> None:
    python = folder / "bin" / "python"
    installed = folder / "requirements.txt"
    if not (installed.exists() and installed.read_text() == REQUIREMENTS.read_text()):
        try:
            subprocess.run([sys.executable, "-m", "venv", "--clear", str(folder)], check=True, capture_output=True)
            pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--retries", "1"]
            command = [*pip, "--timeout", "15", "-r", str(REQUIREMENTS)]
            subprocess.run(command, check=True, capture_output=True, timeout=INSTALL_S_MAX)
        except (OSError, subprocess.SubprocessError) as error:
            words = (getattr(error, "stderr", None) or str(error).encode()).decode(errors="replace").strip()
            print("skip", words.splitlines()[-1] if words else error)
            return
        installed.write_text(REQUIREMENTS.read_text())
    print("python", python)


def simulator(kind: str):
    if kind == "mt_sics":
        from labmcp_mettler_toledo.simulator import MTSICSSimulator

        return MTSICSSimulator()
    from labmcp_sartorius.simulator import SBISimulator

    return SBISimulator(fmt=16 if kind == "sbi16" else 22)


def serve(kind: str) -> None:
    balance, lock = simulator(kind), threading.Lock()
    listener = socket.create_server(("127.0.0.1", 0))
    threading.Thread(target=accept, args=(listener, balance, lock), daemon=True).start()
    print(f"listening tcp://127.0.0.1:{listener.getsockname()[1]}", flush=True)
    for order in sys.stdin:
        verb, _, argument = order.strip().partition(" ")
        with lock:
            if verb == "load" and hasattr(balance, "place"):
                balance.place(float(argument))
            elif verb == "load":
                balance.load_g = float(argument)
            elif verb == "adjust":
                balance.handle("\x1bZ")
        print("done", flush=True)


def accept(listener: socket.socket, balance, lock: threading.Lock) -> None:
    while True:
        connection, _ = listener.accept()
        with connection:
            converse(connection, balance, lock)


def converse(connection: socket.socket, balance, lock: threading.Lock) -> None:
    heard = b""
    while piece := connection.recv(256):
        heard += piece
        while b"\r\n" in heard:
            command, _, heard = heard.partition(b"\r\n")
            with lock:
                reply = balance.handle(command.decode("ascii", errors="replace"))
            lines = [reply] if isinstance(reply, str) else reply or []
            connection.sendall("".join(f"{line}\r\n" for line in lines).encode("ascii"))


def clients(*arguments: str) -> None:
    for kind, address in zip(arguments[::2], arguments[1::2], strict=True):
        print(json.dumps(client(kind, address)))


def client(kind: str, address: str) -> dict:
    from labmcp import InstrumentError, open_transport

    transport = open_transport(address, read_termination="\r\n", write_termination="\r\n", timeout=5.0)
    if kind == "mt_sics":
        from labmcp_mettler_toledo.driver import MTSICSBalance as Balance
    else:
        from labmcp_sartorius.driver import SBIBalance as Balance
    balance = Balance(transport)
    try:
        found = {"identity": balance.identify(), "gross": shown(balance.weight(stable=True))}
        balance.tare()
        found["net"] = shown(balance.weight(stable=True))
        found["now"] = shown(balance.weight(stable=False))
        return found
    except InstrumentError as error:
        return {"error": str(error)}


def shown(weight) -> dict:
    return {"value": weight.value, "unit": weight.unit, "stable": weight.stable}


def main() -> None:
    verb, *arguments = sys.argv[1:]
    if verb == "install":
        install(pathlib.Path(arguments[0]))
    else:
        {"serve": serve, "client": clients}[verb](*arguments)


if __name__ == "__main__":
    main()
