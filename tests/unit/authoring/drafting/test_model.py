"""Settings of a model: where they come from, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.authoring.drafting.model import ModelSettings, read_key, read_model_settings
from pcmrs.errors import BlueprintError, ConfigurationError


def test_what_is_given_precedes_the_file(tmp_path: Path) -> None:
    file = tmp_path / "model.toml"
    file.write_text('url = "http://127.0.0.1/v1"\nmodel = "small"\nattempts = 2\n')
    settings = read_model_settings(file, model="large")
    assert (settings.url, settings.model, settings.attempts) == ("http://127.0.0.1/v1", "large", 2)
    assert read_model_settings(None, "http://[::1]/v1", "x") == ModelSettings(url="http://[::1]/v1", model="x")


@pytest.mark.parametrize("text", ["key = 'secret'", "attempts = 0", "idle_s = 0", "no toml"])
def test_a_file_with_faults_is_refused(text: str, tmp_path: Path) -> None:
    """A key has no place in it: such files are shared."""
    file = tmp_path / "model.toml"
    file.write_text(text)
    with pytest.raises(BlueprintError, match=r"model\.toml:1"):
        read_model_settings(file)
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_model_settings(tmp_path / "none.toml")


def test_the_key_is_read_from_a_file_of_its_owner(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_text("from-file\n")
    settings = ModelSettings(key_file=str(file))
    file.chmod(0o600)
    assert read_key(settings, "") == "from-file"
    assert read_key(settings, "given") == "given"
    assert read_key(ModelSettings(), "") == ""
    file.chmod(0o644)
    with pytest.raises(ConfigurationError, match="mode 0644"):
        read_key(settings, "")
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_key(ModelSettings(key_file=str(tmp_path / "none")), "")


def test_a_key_that_is_none_is_refused_without_showing_it() -> None:
    """An error of the client further down would show it."""
    assert read_key(ModelSettings(), "sk-secret\n") == "sk-secret"
    for key in ("sk-secret\nsecond", "sk-secret second", "sk-secr\u00e9t"):
        with pytest.raises(ConfigurationError, match="in one line") as refused:
            read_key(ModelSettings(), key)
        assert "sk-" not in refused.value.text


@pytest.mark.parametrize("host", ["model.example.org", "192.0.2.1"])
def test_the_key_never_travels_unencrypted(host: str) -> None:
    settings = ModelSettings(url=f"http://{host}/v1", model="m")
    with pytest.raises(ConfigurationError, match="unencrypted"):
        settings.check("secret")
    settings.check("")
    ModelSettings(url=f"https://{host}/v1", model="m").check("secret")
    ModelSettings(url="http://localhost:8080/v1", model="m").check("secret")
    with pytest.raises(ConfigurationError, match="PCMRS_MODEL"):
        ModelSettings(url="http://localhost:8080/v1").check("")
