"""Settings of a language model behind the HTTP interface of OpenAI, which local servers share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

import msgspec

from pcmrs.errors import ConfigurationError, PcmrsError
from pcmrs.files import read_secret
from pcmrs.fsm.files.toml import convert, read_bounded, read_toml
from pcmrs.hosts import is_this_machine

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Count = Annotated[int, msgspec.Meta(ge=1)]
Price = Annotated[float, msgspec.Meta(ge=0.0)]


class ModelError(PcmrsError):
    """A model gives no usable answer.

    The field ``why`` is ``unreachable`` (after all attempts), ``http`` (the server refuses the request), ``malformed``
    (what it sends is not of the interface), ``refused`` (by the model), or ``limit`` (of tokens or cost).
    """

    code = "model_failed"


class ModelSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A model, and limits of its use.

    Attributes:
        url: Address of the interface, such as ``http://127.0.0.1:11434/v1``.
        model: Name of the model, as the server knows it.
        key_file: File with the key of the interface, which only its owner can read; empty for none.
        connect_s: Limit for the connection, s.
        idle_s: Limit between two pieces of an answer, and for the first, s.
        answer_s: Limit for a whole answer, s.
        attempts: Number of attempts to get one answer.
        backoff_s: Pause before the second attempt, s; it doubles with each further one.
        answer_tokens: Limit of one answer, tokens.
        total_tokens: Limit of one draft, tokens of requests and answers together.
        total_cost: Limit of the cost of one draft, in the currency of the prices; 0 for no limit.
        request_price: Price of a million tokens of requests.
        answer_price: Price of a million tokens of answers.
        limit_key: Key of the request that holds `answer_tokens`: servers differ.
        temperature: Temperature of the sampling; None for that of the server.
    """

    url: str = ""
    model: str = ""
    key_file: str = ""
    connect_s: Positive = 10.0
    idle_s: Positive = 120.0
    answer_s: Positive = 900.0
    attempts: Count = 4
    backoff_s: Positive = 1.0
    answer_tokens: Count = 16_000
    total_tokens: Count = 400_000
    total_cost: Price = 0.0
    request_price: Price = 0.0
    answer_price: Price = 0.0
    limit_key: Literal["max_tokens", "max_completion_tokens"] = "max_tokens"
    temperature: float | None = None

    def check(self, key: str) -> None:
        """Refuse settings with which nothing can be asked, or the key would be readable on the way.

        Args:
            key: Key of the interface; empty for none.

        Raises:
            ConfigurationError: Address or model are missing or not possible.
        """
        address = urlsplit(self.url)
        if address.scheme not in ("http", "https") or not address.hostname:
            text = f"{self.url!r} is not the address of a model: set PCMRS_MODEL_URL, as in http://127.0.0.1:11434/v1."
            raise ConfigurationError(text, url=self.url)
        if address.username or address.password:
            raise ConfigurationError("The address of a model must not hold a password: set PCMRS_MODEL_KEY.")
        if not self.model:
            raise ConfigurationError("The name of the model is missing: set PCMRS_MODEL.")
        if key and address.scheme == "http" and not is_this_machine(address.hostname):
            text = f"The key would travel unencrypted to {address.hostname}: use https."
            raise ConfigurationError(text, url=self.url)

    def cost(self, request_tokens: int, answer_tokens: int) -> float:
        """Return the cost of some tokens.

        Args:
            request_tokens: Tokens of requests.
            answer_tokens: Tokens of answers.
        """
        return (request_tokens * self.request_price + answer_tokens * self.answer_price) / 1e6


def read_model_settings(file: Path | None, url: str = "", model: str = "") -> ModelSettings:
    """Return the settings in a TOML file; address and model that are given precede those in it.

    Args:
        file: The file; None for the defaults.
        url: Address of the interface.
        model: Name of the model.

    Raises:
        BlueprintError: The file is not TOML, or a key or value is not possible; `findings` has where.
        ConfigurationError: The file cannot be read.
    """
    settings = ModelSettings()
    if file is not None:
        try:
            raw = read_bounded(file)
        except OSError as error:
            raise ConfigurationError(f"{file} cannot be read: {error.strerror}.", file=str(file)) from None
        content, places = read_toml(raw, str(file))
        settings = convert(content, ModelSettings, places)
    return msgspec.structs.replace(settings, url=url or settings.url, model=model or settings.model)


def read_key(settings: ModelSettings, key: str) -> str:
    """Return the key of the interface: the given one, or that in the file that the settings name.

    Args:
        settings: The settings.
        key: Key from the environment; empty for none.

    Raises:
        ConfigurationError: The file cannot be read, others may read it, or it is no key.
    """
    if not key and settings.key_file:
        try:
            key = read_secret(Path(settings.key_file)).decode()
        except (OSError, ValueError) as error:
            text = f"The key {settings.key_file} cannot be read: {error}."
            raise ConfigurationError(text, file=settings.key_file) from None
    key = key.strip()
    if not (key.isascii() and key.isprintable()) or " " in key:
        # Not shown: an error of the client further down would show it.
        raise ConfigurationError(
            "The key of the model has blanks or characters that a key cannot have: give it in one line."
        )
    return key
