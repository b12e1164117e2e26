"""A missing package is named with the extra that installs it."""

from __future__ import annotations

import pytest

from pcmrs.extras import EXTRAS, POSIX, missing_module


def missing(name: str | None) -> ModuleNotFoundError:
    return ModuleNotFoundError(f"No module named {name!r}", name=name)


@pytest.mark.parametrize(("extra", "modules"), EXTRAS.items())
def test_submodule_of_an_extra_names_that_extra(extra: str, modules: tuple[str, ...]) -> None:
    for module in modules:
        error = missing_module(missing(f"{module}.deep.inside"))
        assert error is not None
        assert (error.fields["package"], extra in error.fields["extras"]) == (module, True)
        assert "install the extra" in error.text


def test_package_of_two_extras_names_both() -> None:
    error = missing_module(missing("scipy"))
    assert error is not None
    assert error.fields["extras"] == ["daemon", "report"]
    assert "daemon or report" in error.text


@pytest.mark.parametrize("module", sorted(POSIX))
def test_module_that_windows_lacks_is_no_missing_package(module: str) -> None:
    error = missing_module(missing(module))
    assert error is not None
    assert (error.fields, "Linux" in error.text) == ({"module": module}, True)


@pytest.mark.parametrize("name", ["no_such_module", "pcmrs.no_such_module", None])
def test_anything_else_stays_the_error_that_it_is(name: str | None) -> None:
    assert missing_module(missing(name)) is None
