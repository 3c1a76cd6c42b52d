"""What the package apprise reaches: the extra ``lineside[apprise]``."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from app.notification.message.compose import Letter
from app.notification.sending.secret_file import NotDeliveredError, read_secret_text
from app.notification.settings import AppriseSettings
from app.server.in_thread import in_thread
from bus.messages import Message


async def notify(settings: AppriseSettings, letter: Letter) -> None:
    """Deliver a message. Raises NotDeliveredError; apprise does not give the reason."""

    def send() -> bool:
        return bool(opened(settings).notify(title=letter.subject, body=letter.body))

    # The thread also imports the package, which takes as long as a tenth of a second.
    if not await in_thread(send):
        raise NotDeliveredError(Message.of("notify_apprise_refused", name=settings.url_file.name))


def opened(settings: AppriseSettings) -> Any:
    """The service of the URL. Raises NotDeliveredError."""
    try:
        package = import_module("apprise")
    except ImportError:
        raise NotDeliveredError(Message("notify_apprise_missing")) from None
    service = package.Apprise()
    if not service.add(read_secret_text(settings.url_file)):
        raise NotDeliveredError(Message.of("notify_apprise_url", path=str(settings.url_file)))
    return service
