"""Register the simulated head and place the coil with the plain client; a refusal gives its reason."""

import json
from pathlib import Path

from pcmrs.client import PlainClient

PLAN = json.loads((Path(__file__).parents[1] / "ratms_plan.json").read_text())

with PlainClient.connect() as cell:
    refused = cell.call("placement.approach")
    print(f"too early: {refused.reason.text if refused.reason else refused.decision}")
    for operation, arguments in (
        ("registration.plan_landmarks", {"landmarks": PLAN["landmarks"]}),
        ("digitization.digitize_all", {}),
        ("registration.register", {}),
        ("toolplan.plan", PLAN["poses"][0]),
        ("robot.connect", {}),
        ("placement.approach", {}),
        ("placement.confirm", {}),
        ("placement.back_off", {}),
        ("placement.home", {}),
    ):
        verdict = cell.call(operation, arguments)
        print(f"{operation}: {verdict.decision}, {verdict.branch} is {verdict.state}")
        if verdict.decision != "accepted":
            raise SystemExit(verdict.reason.text if verdict.reason else "no reason given")
        cell.until(lambda state: not state.running)  # connecting also locates the arm
    residual = cell.gathered().residual
    print(f"the landmarks fit within {1000.0 * (residual or 0.0):.1f} mm on average")
