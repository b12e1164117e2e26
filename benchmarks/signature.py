"""Cost of the signature of a person's message for the sender, and for the daemon that checks it.

Medians over single messages, in one thread, of a command and a set point: signing, and checking with a certificate that
was verified before, as for all messages of a member except the first. Names, keys and certificates are temporary.

    .venv/bin/python benchmarks/signature.py [--count 1000] [--json]
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import tempfile
import time
from pathlib import Path

from pcmrs.bus import BusSettings
from pcmrs.bus.codec import pack
from pcmrs.bus.commands import Envelope
from pcmrs.bus.signature import CertificateSigner, SignatureVerifier
from pcmrs.clock import SystemClock
from pcmrs.messages import TeleopSetpoint
from pcmrs.pki import Authority, read_credentials

MESSAGES = {
    "cmd/tom/robot/connect": pack(Envelope(id="0" * 32, sent=1.5, ttl=5.0)),
    "teleop/tom": pack(TeleopSetpoint(sequence=7, sent=1.5, seen=1.5, ttl=0.5, twist=(0.01,) * 6)),
}


def measure(
    key: str, payload: bytes, signer: CertificateSigner, signatures: SignatureVerifier, count: int
) -> dict[str, float]:
    """Return the medians for one message, us of processor time, and the number of bytes of the signature.

    Args:
        key: Key below the prefix of the cell.
        payload: Bytes of the message.
        signer: CertificateSigner of the sender.
        signatures: Verifier of the daemon.
        count: Number of messages.
    """
    absolute, signing, checking = f"pcmrs/lab/cell1/{key}", [], []
    for _ in range(count):
        started = time.thread_time_ns()
        signature = signer.sign("put", absolute, payload)
        signing.append(time.thread_time_ns() - started)
        started = time.thread_time_ns()
        error = signatures.objection(signature, "put", "tom", absolute, payload)
        checking.append(time.thread_time_ns() - started)
        if error is not None:
            raise SystemExit(error.text)
    return {
        "signing": round(statistics.median(signing) / 1e3, 1),
        "checking": round(statistics.median(checking) / 1e3, 1),
        "bytes": len(signature),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    clock = SystemClock()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        authority = Authority.init(folder / "pki", "lab", clock.wall())
        authority.issue("daemon", "cell1", clock.wall(), cells=("lab/*",), into=folder)
        authority.issue("operator", "tom", clock.wall(), via=("gate",), cells=("lab/*",), into=folder)
        daemon = BusSettings(
            mode="router",
            credentials=read_credentials(folder / "cell1", clock.wall()),
            members=tuple(authority.identities()),
        )
        signatures = SignatureVerifier(daemon, clock)
        signer = CertificateSigner.read(read_credentials(folder / "tom", clock.wall()), clock)
        found = {key: measure(key, payload, signer, signatures, options.count) for key, payload in MESSAGES.items()}
    if options.json:
        print(json.dumps(found))
        return
    print(
        f"{platform.platform()}, Python {platform.python_version()}; medians of {options.count}, processor time in us"
    )
    for key, values in found.items():
        print(f"  {key:<24}", "  ".join(f"{each} {value:g}" for each, value in values.items()))


if __name__ == "__main__":
    main()
