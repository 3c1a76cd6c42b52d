"""The difference of two texts of the configuration shows what was changed, and no secret."""

from __future__ import annotations

from app.system.configuration.document import difference, masked
from tests.for_each import for_each


def changed(before: str, now: str) -> list[tuple[str, int, str]]:
    found = difference(before, now)
    return [(each.kind, each.number, each.text) for each in found if each.kind != "same"]


def test_lines_have_their_numbers_and_some_around_them() -> None:
    before = "".join(f"k{n} = {n}\n" for n in range(20))
    now = before.replace("k3 = 3\n", "k3 = 4\n").replace("k15 = 15\n", "")
    assert changed(before, now) == [
        ("gone", 4, "k3 = 3"),
        ("new", 4, "k3 = 4"),
        ("gap", 0, ""),
        ("gone", 16, "k15 = 15"),
    ]
    assert len(difference(before, now)) == 12
    assert difference(before, before) == []


@for_each(
    "text",
    [
        '[store]\nurl = "postgresql://lineside:s3cret@db/lineside"\n',
        '[store]\nurl = "postgresql://db/lineside?password=s3cret"\n',
        '[[notify.webhook]]\nurl = "https://hooks.example/s3cret"  # of Ann\n',
        "# url = 'https://hooks.example/s3cret'\n",
        '# password = "s3cret"\n',
        'url = """\\\n  https://hooks.example/\\\n  s3cret"""\n',
        '"url" = "https://hooks.example/s3cret"\n',
        'port = "socket://user:s3cret@10.0.0.5:4001"\n',
        'token = "s3cret"\nname = "broken\n',
        'webhook.url = "s3cret"\n',
    ],
)
def test_a_secret_is_masked(text: str) -> None:
    assert "s3cret" not in masked(text)
    assert len(masked(text).splitlines()) == len(text.splitlines())


def test_whether_a_secret_differs_is_shown() -> None:
    one, other = '[store]\nurl = "a://b:c@d"\n', '[store]\nurl = "a://b:x@d"\n'
    assert [kind for kind, _, _ in changed(one, other)] == ["gone", "new"]
    assert changed(one, one) == []


@for_each(
    "text",
    [
        'password_file = "smtp.password"\n',
        'dashboard_url = "https://lineside.plant.example"\n',
        'secret_file = "hook.key"\nurl_file = "hook.url"\n',
        'name = "Curl = 5"\n',
    ],
)
def test_other_keys_are_shown(text: str) -> None:
    assert masked(text) == text
