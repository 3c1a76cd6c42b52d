"""``[server.sessions]`` and ``[oidc]`` of lineside.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, field_validator, model_validator

from app.core.server.settings import WebUrl, is_loopback
from bus.messages import Message
from bus.settings import StrictModel
from bus.validation import OneLine, setting_fault


class Sessions(StrictModel):
    """The duration of a sign-in: since it was last used, and in all."""

    idle_hours: Annotated[float, Field(strict=True, ge=0.25, le=168)] = 12
    """The hours since its last use that a session lasts: a shift and its overlap."""
    total_days: Annotated[float, Field(strict=True, ge=0.04, le=90)] = 7
    panel_idle_days: Annotated[float, Field(strict=True, ge=0.04, le=365)] = 90
    """The same in days for a panel on the wall, which stays signed in."""
    panel_total_days: Annotated[float, Field(strict=True, ge=0.04, le=3650)] = 365

    @model_validator(mode="after")
    def _idle_is_not_longer_than_all(self) -> Sessions:
        if self.idle_hours > 24 * self.total_days:
            raise ValueError(Message("setting_idle_hours"))
        if self.panel_idle_days > self.panel_total_days:
            raise ValueError(Message("setting_panel_idle_days"))
        return self


def _issuer(url: str) -> str:
    """Return the URL of a provider. Raise ValueError if it identifies none, or is reached in clear."""
    parts = urlsplit(url)
    if parts.query or parts.fragment:
        raise setting_fault(Message("setting_issuer"))
    if parts.scheme == "http" and not is_loopback(parts.hostname or ""):
        raise setting_fault(Message("setting_issuer_in_clear"))
    return url


ProviderRole = Literal["viewer", "operator", "engineer", "admin"]
ShortName = Annotated[OneLine, Field(min_length=1, max_length=200)]


class OidcSettings(StrictModel):
    """The provider of company accounts, by OpenID Connect."""

    issuer: Annotated[WebUrl, AfterValidator(_issuer)]
    client_id: ShortName
    client_secret_file: Path
    """Relative to the configuration; absolute once loaded."""
    roles: Annotated[dict[ShortName, ProviderRole], Field(min_length=1, max_length=200)]
    """The role for each group of the provider."""
    groups_claim: ShortName = "groups"
    name_claim: ShortName = "preferred_username"
    scopes: Annotated[tuple[ShortName, ...], Field(max_length=20)] = ("openid", "profile", "email")
    ca_file: Path | None = None
    """Whom to trust instead of the authorities of the machine."""

    @property
    def host(self) -> str:
        """The name of the provider in messages."""
        return urlsplit(self.issuer).netloc

    @field_validator("scopes")
    @classmethod
    def _scopes_are_of_openid(cls, scopes: tuple[str, ...]) -> tuple[str, ...]:
        if "openid" not in scopes or any(" " in scope for scope in scopes):
            raise ValueError(Message("setting_oidc_scopes"))
        return scopes
