"""The files of docs/containers.md name paths, ports and commands that there are."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from app.cli import cli
from app.cli.accounts import token
from app.cli.install_service import CONFIGURATION, DATA, INSTALLED
from app.settings import Settings, load
from release.__main__ import platform_tag
from tests.test_architecture import ROOT, text_of
from tests.test_service_unit import UNITS, Unit

DEPLOY = ROOT / "docs" / "deploy"
QUADLET = DEPLOY / "quadlet"
TEXT = text_of(ROOT / "docs" / "containers.md")
IMAGE = [
    line.split(maxsplit=1)
    for line in text_of(DEPLOY / "Containerfile").splitlines()
    if line and not line.startswith("#")
]


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """What the documented configuration comes to."""
    [toml] = re.findall(r"```toml\n(.*?)```", TEXT, re.S)
    file = tmp_path / "lineside.toml"
    file.write_text(toml)
    return load(file)


def quadlet() -> Any:
    """The container unit; of the keys that are there twice, those are read that are different."""
    text = text_of(QUADLET / "lineside.container")
    return Unit(re.sub(r"^Volume=lineside.*\n", "", text, flags=re.M))


def compose() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(text_of(DEPLOY / "compose.yaml"))
    return found


def parsed(words: list[str]) -> dict[str, Any]:
    """The options of a command, as the product reads them; fails where it would refuse them."""
    context = cli.make_context("lineside", list(words), resilient_parsing=False)
    _, command, _ = cli.resolve_command(context, words[:1])
    assert command is not None, words
    return command.make_context(words[0], words[1:]).params


def image(step: str) -> list[str]:
    return [words for name, words in IMAGE if name == step]


def test_the_image_installs_the_bundle_and_is_not_root() -> None:
    [copied] = [words.split()[0] for words in image("COPY")]
    assert Path(f"lineside-1.0-{platform_tag()}.tar.gz").match(copied)
    assert image("FROM") == [f"python:{platform_tag()[2]}.{platform_tag()[3:5]}-slim-bookworm"]
    assert any("install.sh /opt/lineside;" in words for words in image("RUN"))
    assert any("psycopg[binary]>=3.2" in words for words in image("RUN"))
    assert image("ENV") == [f"PATH={INSTALLED.parent}:$PATH"]
    assert image("ENTRYPOINT") == ['["lineside"]']
    assert IMAGE.index(["USER", "lineside"]) > max(
        place for place, step in enumerate(IMAGE) if step[0] == "RUN"
    )


def test_its_user_owns_the_configuration_outside() -> None:
    numbers = re.findall(r"--[ug]id (\d+)", " ".join(image("RUN")))
    assert set(re.findall(r"-[og] (\d+)", TEXT)) == set(numbers)
    assert numbers == [numbers[0]] * 3, "of the group, of the user, and of the user's group"
    assert f"--home-dir {DATA} " in " ".join(image("RUN"))
    assert image("VOLUME") == [str(DATA)]


def test_compose_and_quadlet_agree(settings: Settings) -> None:
    app, unit = compose()["services"]["app"], quadlet()["Container"]
    assert app["command"] == unit["Exec"].split()
    assert app["healthcheck"]["test"] == ["CMD", *unit["HealthCmd"].split()]
    assert app["ports"] == [unit["PublishPort"]] == [f"{settings.server.port}:{settings.server.port}"]
    assert app["volumes"] == [unit["Volume"].removesuffix(":Z"), f"data:{DATA}"]
    assert f"Volume=lineside.volume:{DATA}\n" in text_of(QUADLET / "lineside.container")
    assert unit["Volume"].split(":")[1] == str(CONFIGURATION.parent)
    assert (app["image"], unit["Image"]) == ("lineside", "localhost/lineside:latest")
    assert str(settings.server.port) in image("EXPOSE")[0].split()


def test_each_command_is_one_of_the_product() -> None:
    unit = quadlet()["Container"]
    for command in (unit["Exec"], unit["HealthCmd"].removeprefix("lineside ")):
        assert parsed(command.split())["config"] == CONFIGURATION
    [created] = re.findall(r"^sudo podman exec (\S+) lineside token (create .*)$", TEXT, re.M)
    name, *words = created[1].split()
    parameters = token.commands[name].make_context(name, words).params
    assert created[0] == unit["ContainerName"]
    assert (parameters["config"], parameters["bus"]) == (CONFIGURATION, "dry-end")


def test_the_data_are_kept_and_every_address_is_served(settings: Settings) -> None:
    assert settings.server.data.parent == DATA, "the audit key may have to be made beside the data"
    assert settings.server.host == "0.0.0.0", "what listens on 127.0.0.1 cannot be published"


def test_the_worker_outside_goes_to_the_published_port(settings: Settings) -> None:
    drop_in = text_of(QUADLET / "lineside-worker.conf")
    [command] = re.findall(r"^ExecStart=(\S.*)$", drop_in, re.M)
    assert "ExecStart=\n" in drop_in, "a second ExecStart of a service that is no oneshot is refused"
    usual = Unit(UNITS["lineside-worker.service"]).service["ExecStart"]
    address = f"http://127.0.0.1:{settings.server.port}"
    assert command == usual.replace("http://server:8000", address)
    assert parsed(shlex.split(command)[1:])["bus"] == settings.bus[0].name
