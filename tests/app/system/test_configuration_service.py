"""The configuration file: written completely, never over what another wrote, and each text is a version."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import app.system.configuration.service as service_module
from app.core.web.access import Person, Role
from app.errors import Problem, StoreError
from app.people.audit.acts import Act
from app.settings import load
from app.system.configuration.document import (
    FOLDER,
    MAX_VERSIONS,
    ConfigurationVersion,
    Edit,
    StoredVersion,
    VersionStore,
    with_values,
)
from app.system.configuration.service import CHANGE, CHANGE_MAIL, ROLL_BACK, ConfigurationFile
from bus.instants import UnixTime
from bus.messages import Message
from tests.app.complete_app import House, complete_app
from tests.app.configuration_file import TEXT, house_with_file, mode_of, written
from tests.for_each import for_each

ANN = Person("ann", Role.ENGINEER, "session")
ADA = Person("ada", Role.ADMIN, "session")
RENAMED = TEXT.replace('"Unwind" ', '"Unwinder" ')


def named(name: str) -> Edit:
    return lambda text: with_values(text, ("bus", 0, "unit", 0), {"name": name})


house = pytest.fixture(house_with_file)


@pytest.fixture
def file(house: House) -> ConfigurationFile:
    return house.services[ConfigurationFile]


def stored(number: int) -> StoredVersion:
    return StoredVersion(ConfigurationVersion(number, UnixTime(0.0), "changed", "d"), "text")


async def save(file: ConfigurationFile, name: str = "Unwinder", reason: str = "as on the drawing") -> None:
    await file.save(ANN, CHANGE, named(name), (await file.present()).digest, reason)


async def refusal(file: ConfigurationFile, name: str, digest: str) -> Problem:
    with pytest.raises(Problem) as refused:
        await file.save(ANN, CHANGE, named(name), digest, "")
    return refused.value


async def test_a_change_keeps_rights_and_comments_and_is_a_version_and_an_event(
    house: House, file: ConfigurationFile, tmp_path: Path
) -> None:
    await save(file)
    assert file.path.read_text() == RENAMED
    assert mode_of(file.path) == 0o644
    assert [path.name for path in file.path.parent.iterdir() if path.name.startswith(".")] == []
    folder = tmp_path / "data" / FOLDER
    assert mode_of(folder) == 0o700
    assert [mode_of(path) for path in folder.iterdir()] == [0o600, 0o600]
    newest, first = await file.versions()
    assert (newest.number, newest.origin, newest.who, newest.reason) == (
        *(2, "changed", "ann"),
        "as on the drawing",
    )
    assert (first.number, first.origin, first.who) == (1, "found", "")
    event = (await house.events("configuration"))[0]
    assert (event["who"], event["what"]) == (
        "ann",
        "configuration file changed, version 2: as on the drawing",
    )
    assert event["message"].startswith('- name = "Unwind" ')


async def test_a_file_that_was_changed_meanwhile_is_not_written(file: ConfigurationFile) -> None:
    began = (await file.present()).digest
    by_hand = TEXT.replace("Nip", "Press")
    file.path.write_text(by_hand)
    problem = await refusal(file, "Unwinder", began)
    assert (problem.status, problem.code) == (409, "superseded")
    assert file.path.read_text() == by_hand
    assert (await file.versions())[0].origin == "by_hand"


@for_each("name", ["", "x" * 61, "a\u202eb"])
async def test_what_the_server_would_not_start_with_is_not_written(
    file: ConfigurationFile, name: str
) -> None:
    problem = await refusal(file, name, (await file.present()).digest)
    assert (problem.status, problem.code) == (422, "invalid")
    assert "lineside.toml:" in problem.detail
    assert file.path.read_text() == TEXT
    assert len(await file.versions()) == 1


async def test_the_running_configuration_is_older_once_the_file_differs(file: ConfigurationFile) -> None:
    assert (await file.present()).is_running
    file.path.write_text(f"# Another comment.\n{TEXT}")
    assert (await file.present()).is_running
    await save(file)
    assert not (await file.present()).is_running


async def test_a_rollback_is_a_version_itself(file: ConfigurationFile) -> None:
    await save(file)
    first = await file.version(1)
    digest = (await file.present()).digest
    await file.save(ADA, ROLL_BACK, lambda _: first.text, digest, "wrong unit")
    assert file.path.read_text() == TEXT
    newest = (await file.versions())[0]
    assert (newest.number, newest.origin, newest.who) == (3, "rolled_back", "ada")


@for_each("act", [CHANGE_MAIL, ROLL_BACK])
async def test_what_may_send_the_password_elsewhere_is_for_admins(file: ConfigurationFile, act: Act) -> None:
    with pytest.raises(Problem) as refused:
        await file.save(ANN, act, named("x"), (await file.present()).digest, "")
    assert refused.value.status == 403
    assert file.path.read_text() == TEXT


async def test_what_was_changed_while_the_server_was_off_is_a_version(tmp_path: Path) -> None:
    config = written(tmp_path)
    async with complete_app(tmp_path, config=config):
        pass
    config.write_text(RENAMED)
    async with complete_app(tmp_path, config=config) as house:
        file = house.services[ConfigurationFile]
        assert [each.origin for each in await file.versions()] == ["by_hand", "found"]
        [event] = await house.events("configuration")
        assert event["what"] == "configuration file changed outside Lineside, version 2"
        assert event["message"].startswith('- name = "Unwind" ')


async def test_a_file_that_cannot_be_written(
    file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service_module.os, "access", lambda *_: False)
    problem = await refusal(file, "Unwinder", (await file.present()).digest)
    assert (problem.status, problem.message.code) == (409, "configuration_read_only")
    assert "root" in problem.detail or file.owner in problem.detail
    assert file.path.read_text() == TEXT


async def test_a_disk_that_is_full_leaves_file_and_versions_as_they_were(
    house: House, file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_path: Path, _before: str, _text: str) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(service_module, "replace_file", full)
    problem = await refusal(file, "Unwinder", (await file.present()).digest)
    assert "No space left on device" in problem.detail
    assert file.path.read_text() == TEXT
    assert len(await file.versions()) == 1
    assert "could not be written" in (await house.events("configuration"))[0]["what"]


async def test_a_file_that_is_changed_in_the_last_moment_is_not_written(
    house: House, file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_hand, record, path = TEXT.replace("Nip", "Press"), file._events.record, file.path

    async def slowly(**fields: Any) -> object:
        number = await record(**fields)
        if path.read_text() == TEXT:
            path.write_text(by_hand)
        return number

    monkeypatch.setattr(file._events, "record", slowly)
    problem = await refusal(file, "Unwinder", (await file.present()).digest)
    assert problem.code == "superseded"
    assert path.read_text() == by_hand
    assert (await house.events("configuration"))[0]["what"] == problem.detail
    assert (await file.present()).text == by_hand
    assert [each.origin for each in await file.versions()] == ["by_hand", "found"]


async def test_a_change_by_hand_is_recorded_once_the_audit_log_is_back(
    house: House, file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def away(**_: object) -> int:
        raise StoreError(Message("server_stopped"))

    file.path.write_text(RENAMED)
    with monkeypatch.context() as patched:
        patched.setattr(file._events, "record", away)
        with pytest.raises(StoreError):
            await file.present()
    await file.present()
    assert (await file.versions())[0].origin == "by_hand"
    assert "changed outside Lineside" in (await house.events("configuration"))[0]["what"]


async def test_without_the_audit_log_nothing_is_written(
    file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def away(**_: object) -> int:
        raise StoreError(Message("server_stopped"))

    digest = (await file.present()).digest
    monkeypatch.setattr(file._events, "record", away)
    with pytest.raises(StoreError):
        await file.save(ANN, CHANGE, named("Unwinder"), digest, "")
    assert file.path.read_text() == TEXT
    assert len(await file.versions()) == 1


async def test_a_broken_file_is_shown_and_kept_as_a_version_and_there_is_a_way_back(
    file: ConfigurationFile,
) -> None:
    first = await file.version(1)
    file.path.write_text("[site\n")
    present = await file.present()
    assert present.data is None
    assert "lineside.toml:1" in str(present.faults[0])
    assert (await file.versions())[0].origin == "by_hand"
    await file.save(ADA, ROLL_BACK, lambda _: first.text, present.digest, "")
    assert load(file.path).site.name == "Mill 7"


async def test_an_absent_file_is_named(file: ConfigurationFile) -> None:
    file.path.unlink()
    with pytest.raises(Problem) as refused:
        await file.present()
    assert "there is no such file" in refused.value.detail


def test_the_newest_versions_are_kept(tmp_path: Path) -> None:
    versions = VersionStore(tmp_path)
    for number in range(1, MAX_VERSIONS + 3):
        versions.add(stored(number))
    kept = [each.version.number for each in versions.every()]
    assert (kept[0], kept[-1], len(kept)) == (MAX_VERSIONS + 2, 3, MAX_VERSIONS)
    assert versions.next_number() == MAX_VERSIONS + 3
    assert versions.one(1) is None


def test_a_damaged_version_is_left_out(tmp_path: Path) -> None:
    versions = VersionStore(tmp_path)
    versions.add(stored(1))
    (tmp_path / FOLDER / "000002.json").write_text("{")
    assert versions.every() == [stored(1)]
