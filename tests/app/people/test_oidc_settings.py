"""``[oidc]`` of lineside.toml, the package that it needs, and what ``lineside check`` states of it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from app.cli.check import oidc
from app.core.lifespan import StartError
from app.people.auth import single_sign_on
from app.settings import ConfigurationError, Settings, load
from tests.app.complete_app import complete_app
from tests.app.played_provider import SECRET, played_provider

OIDC = '[oidc]\nissuer = "{issuer}"\nclient_id = "lineside"\nclient_secret_file = "oidc.secret"\n'
ROLES = 'roles = { "line-operators" = "operator" }\n'


def written(folder: Path, text: str) -> Path:
    file = folder / "lineside.toml"
    file.write_text(text)
    return file


def test_the_contract(tmp_path: Path) -> None:
    settings = load(written(tmp_path, OIDC.format(issuer="https://login.plant.example/realm") + ROLES)).oidc
    assert settings is not None
    assert settings.client_secret_file == tmp_path / "oidc.secret"
    assert settings.roles == {"line-operators": "operator"}
    assert (settings.groups_claim, settings.name_claim) == ("groups", "preferred_username")
    assert load(written(tmp_path, "")).oidc is None


@pytest.mark.parametrize(
    ("issuer", "others", "text"),
    [
        ("http://login.plant.example", ROLES, "https://"),
        ("http://127.0.0.1.plant.example", ROLES, "https://"),
        ("ftp://login.plant.example", ROLES, "https:// or http://"),
        ("https://login.plant.example?x", ROLES, "without a question mark"),
        ("https://login.plant.example/#x", ROLES, "without a question mark"),
        ("https://me:secret@login.plant.example", ROLES, "password"),
        ("https://login.plant.example", "", "roles"),
        ("https://login.plant.example", "roles = {}\n", "roles"),
        ("https://login.plant.example", 'roles = { "x" = "worker" }\n', "viewer"),
        ("https://login.plant.example", ROLES + 'scopes = ["profile"]\n', "openid"),
        ("https://login.plant.example", ROLES + 'scopes = ["openid x"]\n', "openid"),
        ("https://login.plant.example", ROLES + "secret = 1\n", "secret"),
    ],
)
def test_a_fault_is_named(tmp_path: Path, issuer: str, others: str, text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"lineside\.toml") as raised:
        load(written(tmp_path, OIDC.format(issuer=issuer) + others))
    assert text in str(raised.value)


async def test_without_the_package_the_server_does_not_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(single_sign_on, "find_spec", lambda _: None)
    async with played_provider() as provider:
        settings = provider.settings(tmp_path)
    with pytest.raises(StartError, match=r"pip install lineside\[oidc\]"):
        async with complete_app(tmp_path, oidc=settings):
            raise AssertionError("it has started")
    [missing] = oidc(Settings.model_construct(oidc=settings))
    assert missing.is_fault


def test_without_the_setting_nothing_of_it_is_loaded(tmp_path: Path) -> None:
    """The start stays as light as it was."""
    program = """
import json, sys
from pathlib import Path
from app.main import create_app
from app.settings import load
create_app(load(Path(sys.argv[1])))
loaded = {name.partition(".")[0] for name in sys.modules}
print(json.dumps(sorted(loaded & {"authlib", "joserfc", "cryptography", "httpx", "httpx2"})))
"""
    command = [sys.executable, "-c", program, str(written(tmp_path, "[site]\n"))]
    assert json.loads(subprocess.run(command, capture_output=True, check=True, timeout=120).stdout) == []


async def test_check_names_the_secret_and_the_provider(tmp_path: Path) -> None:
    import asyncio

    async with played_provider() as provider:
        settings = provider.settings(tmp_path)
        settings.client_secret_file.chmod(0o604)

        def texts() -> list[tuple[bool, str]]:
            return [
                (each.is_fault, str(each.message)) for each in oidc(Settings.model_construct(oidc=settings))
            ]

        found = await asyncio.to_thread(texts)
        assert [is_fault for is_fault, _ in found] == [False, False]
        assert "can be read by every user of this machine" in found[0][1]
        assert found[1][1] == f"provider of company accounts {provider.issuer} responds"
        assert SECRET not in str(found)
        settings.client_secret_file.unlink()
        provider.metadata = {"issuer": "https://other.example"}
        found = await asyncio.to_thread(texts)
        assert [is_fault for is_fault, _ in found] == [True, True]
        assert "cannot be read" in found[0][1]
        assert "of the issuer https://other.example; write issuer in [oidc] exactly so" in found[1][1]
    refused = await asyncio.to_thread(texts)
    assert "is not reached" in refused[1][1]
