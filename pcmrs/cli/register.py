"""`pcmrs register`: registers digitized landmarks to planned ones, and checks that the result may be used."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from pcmrs.cli.options import OutputFile, json_option, plot_option
from pcmrs.cli.printing import say, say_lines
from pcmrs.cli.running import EXIT_REJECTED, readable_errors
from pcmrs.cli.values import POSITIVE
from pcmrs.errors import ConfigurationError, DegeneratePointsError

if TYPE_CHECKING:
    from pcmrs.formats.landmarks import Pairs
    from pcmrs.registration import PointRegistration, RegistrationGate, RegistrationLimits, RegistrationVerdict


FARTHEST_TARGET = 1.0  # m from the origin of the image: beyond it, the value was probably meant in mm
LENGTHS = ("residual_too_large", "tre_too_large")
"""Gates whose value is a length."""


class PointParameter(click.ParamType[tuple[float, float, float]]):
    """X,Y,Z in m."""

    name = "X,Y,Z"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the point, or fail with a usage error."""
        try:
            x, y, z = (float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} is not three numbers such as 0.03,0,0.11.", param, ctx)
        if not max(abs(x), abs(y), abs(z)) <= FARTHEST_TARGET:
            self.fail(f"{value} is beyond {FARTHEST_TARGET:g} m; give metres, not millimetres.", param, ctx)
        return x, y, z


@click.command()
@click.argument("plan", type=click.Path(path_type=Path))
@click.argument("digitized", type=click.Path(path_type=Path))
@click.option(
    "--target",
    type=PointParameter(),
    help="Point at which the error matters, in the image, m; by default the centroid of the landmarks.",
)
@click.option(
    "--workflow", default="ratms", show_default=True, help="Name or file of the workflow that gives the default limits."
)
@click.option("--limit-mm", type=POSITIVE, help="Largest mean distance of the landmarks.")
@click.option("--tre-limit-mm", type=POSITIVE, help="Largest predicted error (rms) at the target.")
@click.option("--sigma-mm", type=POSITIVE, help="Noise of a digitized landmark per axis.")
@click.option("--unit", type=click.Choice(["m", "mm"]), help="Unit of CSV columns x, y, z whose names have none.")
@plot_option
@click.option("-o", "--output", type=OutputFile(), help="Write an accepted registration (lab YAML).")
@json_option
@readable_errors
def register(plan: Path, digitized: Path, plot: Path | None, output: Path | None, as_json: bool, **given: Any) -> None:
    """Register the landmarks in DIGITIZED (body_ref) to those in PLAN (image), and check the result.

    Files: YAML of the lab's software (PLANNED or DIGITIZED, m), 3D Slicer markups (.mrk.json, .fcsv; LPS or RAS as
    declared), CSV with a header such as name,x_mm,y_mm,z_mm, and PCMRS plans (.json). Landmarks are paired by name
    if both files have the same names, else by order.

    Exit status 0: accepted, 1: refused, 5: a file cannot be read or does not match the other.

    Example: pcmrs register plan.mrk.json dig.yaml --target 0.03,0,0.11 --plot reg.png
    """
    from pcmrs.formats.landmarks import pair_landmarks, read_landmarks
    from pcmrs.registration import judge

    if output is not None and output.resolve() in (plan.resolve(), digitized.resolve()):
        raise click.UsageError(f"{output} is an input file and would be overwritten; give another file with -o.")
    pairs = pair_landmarks(read_landmarks(plan, given["unit"]), read_landmarks(digitized, given["unit"]))
    limits = _limits(**{name: given[name] for name in ("workflow", "limit_mm", "tre_limit_mm", "sigma_mm")})
    try:
        verdict = judge(pairs.planned, pairs.digitized, limits, names=pairs.names, target=given["target"])
    except DegeneratePointsError as error:
        file = {"fixed": f"{digitized}: ", "moving": f"{plan}: "}.get(error.fields.get("points", ""), "")
        refusal = error.fields | {"code": error.code, "text": file + error.text}
        _say({"accepted": False, "refusal": refusal}, [f"REFUSED: {file}{error.text}"], as_json)
        sys.exit(EXIT_REJECTED)
    place = "at the target" if given["target"] else "at the centroid of the landmarks"
    _say(_as_object(pairs, verdict), _lines(pairs, verdict, place), as_json)
    _write(pairs, verdict, limits, plot, output)
    if not verdict.accepted:
        sys.exit(EXIT_REJECTED)


def _limits(
    workflow: str, limit_mm: float | None, tre_limit_mm: float | None, sigma_mm: float | None
) -> RegistrationLimits:
    """Return the given limits; missing ones are those of a cell with this workflow."""
    from pcmrs.registration import RegistrationLimits
    from pcmrs.settings import read_settings

    try:
        default = read_settings(overrides=[f"workflow={workflow}"]).procedure.registration
    except ConfigurationError as error:
        raise click.UsageError(error.text) from None
    return RegistrationLimits(
        residual=(limit_mm or default.residual_limit_mm) / 1000.0,
        sigma=(sigma_mm or default.sigma_mm) / 1000.0,
        tre=(tre_limit_mm or default.tre_limit_mm) / 1000.0,
        false_alarm=default.false_alarm,
    )


def _write(
    pairs: Pairs, verdict: RegistrationVerdict, limits: RegistrationLimits, plot: Path | None, output: Path | None
) -> None:
    registration = verdict.registration
    if plot is not None and registration is None:
        say(f"{plot} is not written: there is no registration to draw.", err=True)
    elif plot is not None and registration is not None:
        from pcmrs.cli.register_plot import draw

        draw(pairs, registration.fixed_from_moving, limits.residual, _heading(verdict), plot)
    if output is not None and (registration is None or not verdict.accepted):
        say(f"{output} is not written: the registration is refused.", err=True)
    elif output is not None and registration is not None:
        from pcmrs.formats.lab_text import lab_registration

        output.write_text(lab_registration(registration.fixed_from_moving, refined=False))


def _say(as_object: dict[str, Any], lines: list[str], as_json: bool) -> None:
    if as_json:
        lines = msgspec.json.format(msgspec.json.encode(as_object)).decode().split("\n")
    say_lines(lines)


def _heading(verdict: RegistrationVerdict) -> str:
    return "accepted" if verdict.refusal is None else f"REFUSED: {verdict.refusal.text}"


def _as_object(pairs: Pairs, verdict: RegistrationVerdict) -> dict[str, Any]:
    refusal, registration = verdict.refusal, verdict.registration
    return {
        "accepted": verdict.accepted,
        "refusal": None if refusal is None else {"code": refusal.name, "text": refusal.text},
        "matched_by": pairs.matched_by,
        "landmarks": pairs.names,
        "suspect": None if verdict.suspect is None else pairs.names[verdict.suspect],
        "permutation": verdict.permutation,
        "tre": verdict.tre,
        "gates": verdict.gates,
    } | ({} if registration is None else _registration_object(registration))


def _registration_object(registration: PointRegistration) -> dict[str, Any]:
    body_ref_from_image = registration.fixed_from_moving
    return {
        "body_ref_from_image": body_ref_from_image.matrix.tolist(),
        "translation": body_ref_from_image.translation.tolist(),
        "quat_wxyz": body_ref_from_image.quat_wxyz.tolist(),
        "residuals": registration.distances.tolist(),
        "mean": registration.residual,
        "rms": registration.rms,
    }


def _lines(pairs: Pairs, verdict: RegistrationVerdict, place: str) -> list[str]:
    lines = [_heading(verdict), f"{len(pairs.names)} landmarks, paired by {pairs.matched_by}"]
    if verdict.registration is not None:
        lines += _registration_lines(pairs, verdict.registration)
    if verdict.tre is not None:
        lines.append(f"predicted TRE {verdict.tre * 1000:.2f} mm rms {place}")
    return [*lines, "", "gates", *(_gate_line(gate) for gate in verdict.gates)]


def _registration_lines(pairs: Pairs, registration: PointRegistration) -> list[str]:
    transform = registration.fixed_from_moving
    rows = ("  " + " ".join(f"{value: .9f}" for value in row) for row in transform.matrix.round(9) + 0.0)
    residuals = (
        f"  {name:<24} {distance * 1000:7.2f}"
        for name, distance in zip(pairs.names, registration.distances, strict=True)
    )
    quat_wxyz = " ".join(f"{value:.9f}" for value in transform.quat_wxyz.round(9) + 0.0)
    return [
        *("", "body_ref_from_image, translation in m", *rows, f"  quaternion w x y z: {quat_wxyz}"),
        *("", "residuals, mm", *residuals),
        f"mean {registration.residual * 1000:.2f} mm, rms {registration.rms * 1000:.2f} mm",
    ]


def _gate_line(gate: RegistrationGate) -> str:
    scale, unit = (1000.0, " mm") if gate.name in LENGTHS else (1.0, "")
    value, limit = (f"{number * scale:.4g}{unit}" for number in (gate.value, gate.limit))
    return f"  {'passed ' if gate.accepted else 'REFUSED'} {gate.name:<20} {value}, limit {limit}"
