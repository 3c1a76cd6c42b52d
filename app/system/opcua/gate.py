"""Limits of the OPC UA server: for channels, sessions and the requests of a client, and the refusal of every
change.

The limits override public methods of asyncua, which leaves the following open: a channel without security may
request endpoints only; a certificate is checked before its channel opens; a session belongs to the connection
that made it (its token is a small number that others can guess); requests, subscriptions and unread data are
bounded.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import structlog
from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import ServiceError
from asyncua.crypto import uacrypto
from asyncua.crypto.permission_rules import PermissionRuleset, User, UserRole
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256, SecurityPolicyFactory
from asyncua.crypto.validator import CertificateValidator
from asyncua.server.binary_server_asyncio import OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager
from asyncua.ua.ua_binary import uatcp_to_binary
from cryptography import x509

from app.system.opcua.access import OwnCertificate, TokenList, TrustList
from app.system.opcua.link import Key
from bus.instants import monotonic_now
from bus.pacing import Bucket

MAX_CONNECTIONS, MAX_CONNECTIONS_OF_ADDRESS = 64, 16
MAX_SESSIONS = 32
SIGN_IN_S = 10.0
"""The time that a connection may take to its session, or stay without a session."""
MIN_SESSION_MS, MAX_SESSION_MS = 5_000, 120_000
MAX_SUBSCRIPTIONS, MAX_SUBSCRIPTIONS_OF_SESSION = 100, 10
MAX_ITEMS, MAX_ITEMS_OF_SESSION = 60_000, 20_000
MIN_PUBLISHING_MS, MAX_PUBLISHING_MS = 100.0, 60_000.0
MAX_QUEUE = 20
MAX_UNCONFIRMED = 10
MAX_LIFETIME, MAX_KEEP_ALIVE = 3_000, 1_000
MIN_CHUNK, MAX_CHUNK, MAX_MESSAGE = 16, 65_535, 1_048_576
MAX_UNREAD = 1_048_576
"""The most unread bytes of a client; with more, nothing is read from it."""
READ_WITHIN_S = 10.0
REQUESTS_PER_S, MAX_REQUESTS_AT_ONCE = 200.0, 1_000.0
REQUEST_BYTES = 1_024
"""The bytes of a message that count as one request."""
MAX_PENDING = 20
MAX_READS, MAX_BROWSES, MAX_PATH = 1_000, 100, 20
MAX_REFERENCES = 5_000
SWEEP_S = 2.0
LOGGERS = "asyncua.server.monitored_item_service."
log = structlog.get_logger()
_READS = frozenset(
    ua.NodeId(getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary"))
    for name in (
        *("Read", "Write", "Call", "Browse", "BrowseNext", "TranslateBrowsePathsToNodeIds"),
        *("RegisterNodes", "UnregisterNodes"),
        *("CreateSubscription", "ModifySubscription", "DeleteSubscriptions", "Publish", "Republish"),
        *("CreateMonitoredItems", "ModifyMonitoredItems", "DeleteMonitoredItems"),
        *("SetMonitoringMode", "SetPublishingMode", "CloseSecureChannel"),
    )
)


class ReadOnly(PermissionRuleset):
    """The permission rules of read-only sessions: only services in ``_READS`` are permitted."""

    def check_validity(self, user: User, action_type: ua.NodeId, body: object) -> bool:  # noqa: ARG002
        """Return whether this user may call the service that ``action_type`` names."""
        return user is not None and user.role == UserRole.User and action_type in _READS


class Tokens(UserManager):
    """The user manager that signs programs in by the name and secret of an API token."""

    def __init__(self, tokens: TokenList) -> None:
        self._tokens = tokens

    def get_user(
        self,
        iserver: InternalServer,  # noqa: ARG002
        username: str | None = None,
        password: str | None = None,
        certificate: bytes | None = None,
    ) -> User | None:
        """Return the user of a token, on a channel with a certificate."""
        if certificate is None or not username or not password:
            return None
        return None if self._tokens.find(username, password) is None else User(UserRole.User, username)


@dataclass(slots=True)
class Refusals:
    """A counter of refusals by reason. Each reason is logged once."""

    by_reason: Counter[str] = field(default_factory=Counter)

    def note(self, reason: str, client: object = "") -> None:
        """Count a refusal, and log the first of each reason."""
        self.by_reason[reason] += 1
        if self.by_reason[reason] == 1:
            log.warning("OPC UA request refused", reason=reason, client=str(client)[:100])

    @property
    def total(self) -> int:
        """The number of refusals of all reasons."""
        return self.by_reason.total()


class ViewerSession(InternalSession):
    """A session of a client that only reads. It belongs to the connection that created it."""

    iserver: ViewerServer

    def __init__(self, *args: Any, **options: Any) -> None:
        self.items: dict[int, set[int]] = {}
        """The ids of monitored items, by subscription."""
        self.key: Key | None = None
        self._certificate: bytes | None = None
        self.reads = asyncio.Event()
        """Set while the client reads the data sent to it."""
        self.reads.set()
        super().__init__(*args, **options)

    async def create_session(self, params: Any, sockname: Any = None) -> Any:
        """Create the session of a client whose certificate has its application URI."""
        if not params.ClientCertificate:
            raise self.iserver.refusal("BadCertificateInvalid", self.name)
        self._certificate = params.ClientCertificate
        return await super().create_session(params, sockname)

    def activate_session(self, params: Any, peer_certificate: bytes | None) -> Any:
        """Sign a program in by its token, on the secure channel of the session's client."""
        if peer_certificate is None or peer_certificate != self._certificate:
            raise self.iserver.refusal("BadSecurityChecksFailed", self.name)
        try:
            result = super().activate_session(params, peer_certificate)
        except (ServiceError, ua.uaerrors.UaStatusCodeError):
            self.iserver.refusals.note("sign-in", self.name)
            raise
        self.key = self.iserver.tokens.keys.get(self.user.name or "")
        return result

    async def close_session(self, delete_subs: bool = True) -> None:  # noqa: ARG002
        """Close the session and its subscriptions, so that no other session can take them over."""
        await super().close_session(True)
        self.items.clear()

    # --- reading ---

    async def read(self, params: Any) -> Any:
        await self._admit(params.NodesToRead, MAX_READS)
        return await super().read(params)

    async def browse(self, params: Any) -> Any:
        await self._admit(params.NodesToBrowse, MAX_BROWSES)
        results = await super().browse(params)
        if sum(len(result.References) for result in results) > MAX_REFERENCES:
            raise self.iserver.refusal("BadResponseTooLarge", self.name)
        return results

    async def translate_browsepaths_to_nodeids(self, params: Any) -> Any:
        await self._admit(params, MAX_READS)
        if any(not 0 < len(path.RelativePath.Elements) <= MAX_PATH for path in params):
            raise self.iserver.refusal("BadTooManyOperations", self.name)
        return await super().translate_browsepaths_to_nodeids(params)

    # --- refusal of changes ---

    async def write(self, params: Any) -> Any:
        """Refuse to write any node."""
        self.iserver.refusals.note("write", self.name)
        return [ua.StatusCode(ua.StatusCodes.BadNotWritable) for _ in params.NodesToWrite]

    async def call(self, params: Any) -> Any:
        """Refuse to call methods."""
        self.iserver.refusals.note("call", self.name)
        denied = ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
        return [ua.CallMethodResult(StatusCode=denied) for _ in params]

    # --- subscriptions ---

    async def create_subscription(self, params: Any, callback: Any, request_callback: Any = None) -> Any:
        """Create a subscription, published no faster than `MIN_PUBLISHING_MS`."""
        self._forget_expired()
        if len(self.items) >= MAX_SUBSCRIPTIONS_OF_SESSION:
            raise self.iserver.refusal("BadTooManySubscriptions", self.name)
        wanted = float(params.RequestedPublishingInterval)
        # NaN is not greater, so it becomes the shortest interval.
        is_longer = wanted > MIN_PUBLISHING_MS
        params.RequestedPublishingInterval = (
            min(wanted, MAX_PUBLISHING_MS) if is_longer else MIN_PUBLISHING_MS
        )
        result = await super().create_subscription(params, callback, request_callback)
        self.items[result.SubscriptionId] = set()
        return result

    async def create_monitored_items(self, params: Any) -> Any:
        self._check_own(params.SubscriptionId)
        await self._admit(params.ItemsToCreate, MAX_READS)
        wanted = len(params.ItemsToCreate)
        of_session = sum(map(len, self.items.values()))
        if of_session + wanted > MAX_ITEMS_OF_SESSION or self.iserver.items + wanted > MAX_ITEMS:
            raise self.iserver.refusal("BadTooManyMonitoredItems", self.name)
        results = await super().create_monitored_items(params)
        made = self.items[params.SubscriptionId]
        made.update(result.MonitoredItemId for result in results if result.StatusCode.is_good())
        return results

    async def modify_monitored_items(self, params: Any) -> Any:
        self._check_own(params.SubscriptionId)
        for item in params.ItemsToModify:
            wanted = item.RequestedParameters
            wanted.QueueSize = min(max(1, wanted.QueueSize), MAX_QUEUE)
        return await super().modify_monitored_items(params)

    async def delete_monitored_items(self, params: Any) -> Any:
        self._check_own(params.SubscriptionId)
        self.items[params.SubscriptionId].difference_update(params.MonitoredItemIds)
        return await super().delete_monitored_items(params)

    async def set_monitoring_mode(self, params: Any) -> Any:
        self._check_own(params.SubscriptionId)
        return await super().set_monitoring_mode(params)

    async def set_publishing_mode(self, params: Any) -> Any:
        for subscription in params.SubscriptionIds:
            self._check_own(subscription)
        return await super().set_publishing_mode(params)

    def modify_subscription(self, params: Any) -> Any:
        self._check_own(params.SubscriptionId)
        return super().modify_subscription(params)

    def republish(self, params: Any) -> Any:
        self._check_own(params.SubscriptionId)
        return super().republish(params)

    async def delete_subscriptions(self, ids: list[int]) -> Any:
        """Delete subscriptions; those of another session count as unknown."""
        unknown = ua.StatusCode(ua.StatusCodes.BadSubscriptionIdInvalid)
        own = [each for each in dict.fromkeys(ids) if each in self.items]
        done = dict(zip(own, await super().delete_subscriptions(own), strict=True))
        for each in own:
            self.items.pop(each, None)
        return [done.get(each, unknown) for each in ids]

    def publish(self, acks: Any = None) -> Any:
        """Acknowledge notifications of the session's own subscriptions; those of another session count as
        unknown."""
        self._forget_expired()
        if not self.items:
            raise ServiceError(ua.StatusCodes.BadNoSubscription)
        known = [each.SubscriptionId in self.items for each in acks or ()]
        super().publish([each for each, is_own in zip(acks or (), known, strict=True) if is_own])
        good, unknown = ua.StatusCode(), ua.StatusCode(ua.StatusCodes.BadSubscriptionIdInvalid)
        return len(self.items), [good if is_own else unknown for is_own in known]

    def _forget_expired(self) -> None:
        alive = self.subscription_service.subscriptions
        for each in [each for each in self.items if each not in alive]:
            del self.items[each]

    def _check_own(self, subscription: int) -> None:
        if subscription not in self.items:
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)

    async def _admit(self, wanted: Any, most: int) -> None:
        """Wait until the client has read its data; refuse a request for more than ``most`` nodes."""
        await self.reads.wait()
        if len(wanted) > most:
            raise self.iserver.refusal("BadTooManyOperations", self.name)


class ViewerServer(InternalServer):
    """The server whose sessions only read, with its certificate, trust list and tokens of programs."""

    def __init__(self, own: OwnCertificate, trust: TrustList, tokens: TokenList) -> None:
        super().__init__(Tokens(tokens))
        self.trust, self.tokens, self.refusals = trust, tokens, Refusals()
        self.sessions: dict[ua.NodeId, ViewerSession] = {}
        self.certificate, self.private_key = own.certificate, own.key
        self.certificate_validator = CertificateValidator()
        self.allow_remote_admin = False
        self.supported_tokens = (ua.UserNameIdentityToken,)
        self.min_session_timeout_ms, self.max_session_timeout_ms = MIN_SESSION_MS, MAX_SESSION_MS
        self.max_pending_activation_seconds = 0.0  # `Gate.sweep` also ends those that do not read
        self.max_connections = MAX_CONNECTIONS
        self.max_pending_messages_per_connection = MAX_PENDING
        self.max_subscriptions = MAX_SUBSCRIPTIONS
        self.max_unacked_messages_per_subscription = MAX_UNCONFIRMED
        self.max_monitored_item_queue_size = MAX_QUEUE
        self.max_lifetime_count, self.max_keep_alive_count = MAX_LIFETIME, MAX_KEEP_ALIVE

    def refusal(self, code: str, client: object = "") -> ServiceError:
        """Count a refusal by its status code, and return the error to raise."""
        self.refusals.note(code, client)
        return ServiceError(getattr(ua.StatusCodes, code))

    @property
    def items(self) -> int:
        """The number of monitored items of all sessions."""
        return sum(len(items) for session in self.sessions.values() for items in session.items.values())

    def create_session(self, name: str, user: User | None = None, external: bool = False) -> ViewerSession:
        """Create the session of a connection, which may have one."""
        if len(self.sessions) >= MAX_SESSIONS or any(each.name == name for each in self.sessions.values()):
            raise self.refusal("BadTooManySessions", name)
        user = user or User(UserRole.Anonymous)
        return ViewerSession(self, self.aspace, self.subscription_service, name, user=user, external=external)

    def lookup_external_session(self, auth_token: ua.NodeId) -> None:
        """Return None: no session moves to another connection."""

    def register_external_session(self, session: InternalSession) -> None:
        if isinstance(session, ViewerSession):
            self.sessions[session.auth_token] = session

    def unregister_external_session(self, session: InternalSession) -> None:
        self.sessions.pop(session.auth_token, None)

    def register_server(self, server: Any, conf: Any = None) -> None:  # noqa: ARG002
        """Refuse other servers: this server is not a directory of them."""
        raise self.refusal("BadServiceUnsupported")

    def add_own_endpoint(self, uri: str, name: str, url: str) -> None:
        """Offer the only endpoint: signed and encrypted, for programs with a token."""
        sign_in = ua.UserTokenPolicy()
        sign_in.PolicyId, sign_in.TokenType = "token", ua.UserTokenType.UserName
        sign_in.SecurityPolicyUri = SecurityPolicyBasic256Sha256.URI
        application = ua.ApplicationDescription()
        application.ApplicationName, application.ApplicationUri = ua.LocalizedText(name), uri
        application.ApplicationType, application.ProductUri = ua.ApplicationType.Server, "urn:lineside"
        application.DiscoveryUrls = [url]
        endpoint = ua.EndpointDescription()
        endpoint.EndpointUrl, endpoint.Server = url, application
        endpoint.ServerCertificate = uacrypto.der_from_x509(self.certificate)
        endpoint.SecurityMode = ua.MessageSecurityMode.SignAndEncrypt
        endpoint.SecurityPolicyUri = SecurityPolicyBasic256Sha256.URI
        endpoint.UserIdentityTokens = [sign_in]
        endpoint.TransportProfileUri = "http://opcfoundation.org/UA-Profile/Transport/uatcp-uasc-uabinary"
        endpoint.SecurityLevel = 100
        self.add_endpoint(endpoint)


class TrustedPolicy(SecurityPolicyFactory):
    """The security policy *Basic256Sha256* with *Sign & Encrypt*, for trusted clients. ``refuse``: ends the
    connection with a reason."""

    def __init__(self, server: ViewerServer, refuse: Callable[[str], None]) -> None:
        mode = ua.MessageSecurityMode.SignAndEncrypt
        super().__init__(
            SecurityPolicyBasic256Sha256, mode, server.certificate, server.private_key, ReadOnly()
        )
        self._trust, self._refuse = server.trust, refuse
        self.peer: bytes | None = None
        """The certificate of the client, once the client is trusted."""

    def matches(self, uri: str, mode: Any = None) -> bool:
        """Return whether a client wants this policy. False for a channel without security, on which the
        server only lists its endpoints."""
        if uri.endswith("#None"):
            return False
        if not super().matches(uri, mode):
            self._refused("BadSecurityPolicyRejected")
        return True

    def create(self, peer_certificate: bytes | None) -> Any:
        """Return the policy of a channel with a client. Raise BadUserAccessDenied for a client that is not
        trusted; the connection is then closed."""
        certificate = bytes(peer_certificate or b"")
        if not self._trust.trusts(certificate):
            self._trust.read()
        if not self._trust.trusts(certificate):
            self._trust.reject(certificate)
            self._refused("BadCertificateUntrusted")
        if not _is_valid_now(certificate):
            self._refused("BadCertificateTimeInvalid")
        self.peer = certificate
        return super().create(certificate)

    def _refused(self, code: str) -> None:
        self._refuse(code)
        raise ua.uaerrors.BadUserAccessDenied


def _is_valid_now(certificate: bytes) -> bool:
    known, now = x509.load_der_x509_certificate(certificate), datetime.now(UTC)
    return known.not_valid_before_utc <= now <= known.not_valid_after_utc


class GuardedConnection(OPCUAProtocol):
    """The connection of a client, with limits for its requests, its unread data, and the time to its
    session."""

    def __init__(self, gate: Gate) -> None:
        super().__init__(gate.server, [], gate.connections, gate.closing, gate.limits)
        self._gate, self.made_at = gate, monotonic_now()
        self.policy = TrustedPolicy(gate.server, self.refuse)
        self._received = bytearray()
        self._requests = Bucket(REQUESTS_PER_S, MAX_REQUESTS_AT_ONCE)
        self._is_full = False
        self._giving_up: asyncio.TimerHandle | None = None
        self._resting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        address = transport.get_extra_info("peername")[0]
        same = sum(each.peer_name[0] == address for each in self._gate.connections)
        if same >= MAX_CONNECTIONS_OF_ADDRESS or len(self._gate.connections) >= MAX_CONNECTIONS:
            self._gate.server.refusals.note("connections", address)
            transport.abort()
            return
        transport.set_write_buffer_limits(high=MAX_UNREAD)
        super().connection_made(transport)
        if self.processor is not None:
            self.processor.set_policies([self.policy])

    def connection_lost(self, ex: BaseException | None) -> None:
        for timer in (self._giving_up, self._resting):
            if timer is not None:
                timer.cancel()
        session = None if self.processor is None else self.processor.session
        super().connection_lost(ex)
        if session is not None:
            # A session with subscriptions would wait for its client's return on another connection.
            self.closing_tasks.append(asyncio.create_task(session.close_session(True)))

    def data_received(self, data: bytes) -> None:
        """Pass each complete chunk to asyncua; refuse other data and chunks that are too large."""
        if self.processor is None or self.transport is None or self.transport.is_closing():
            return
        self._received += data
        while len(self._received) >= 8:
            size = int.from_bytes(self._received[4:8], "little")
            # Data of another protocol, such as HTTP or TLS, has an absurd size here.
            if not MIN_CHUNK <= size <= MAX_CHUNK:
                self.refuse("BadTcpMessageTooLarge")
                return
            if len(self._received) < size:
                return
            chunk = bytes(self._received[:size])
            del self._received[:size]
            super().data_received(chunk)
            self._rest_after(size)

    def _rest_after(self, size: int) -> None:
        """Pause reading from a client that sends too many or too large requests."""
        pause = self._requests.pour(1.0 + size / REQUEST_BYTES, monotonic_now())
        if pause > 0.0 and self._resting is None and self.transport is not None:
            self._gate.server.refusals.note("rate", self.peer_name)
            self.transport.pause_reading()
            self._resting = asyncio.get_running_loop().call_later(min(pause, 5.0), self._rested)

    def _rested(self) -> None:
        self._resting = None
        self._read_again()

    def _read_again(self) -> None:
        if self._resting is None and not self._is_full and self.transport and not self.transport.is_closing():
            self.transport.resume_reading()

    def pause_writing(self) -> None:
        """Pause reading from a client that does not read; give it up if that lasts."""
        self._is_full = True
        if self.session is not None:
            self.session.reads.clear()
        if self.transport is not None:
            self.transport.pause_reading()
            later = asyncio.get_running_loop().call_later
            self._giving_up = later(READ_WITHIN_S, self.give_up, "does not read")

    def resume_writing(self) -> None:
        self._is_full = False
        if self.session is not None:
            self.session.reads.set()
        if self._giving_up is not None:
            self._giving_up.cancel()
            self._giving_up = None
        self._read_again()

    def refuse(self, code: str) -> None:
        """Send an error that the client shows, and close the connection."""
        self._gate.server.refusals.note(code, self.peer_name)
        if self.transport is not None and not self.transport.is_closing():
            error = ua.ErrorMessage(ua.StatusCode(getattr(ua.StatusCodes, code)), code)
            self.transport.write(uatcp_to_binary(ua.MessageType.Error, error))
            self.transport.close()

    def give_up(self, reason: str) -> None:
        """Abort the connection of a client that does not read, or has no session."""
        self._gate.server.refusals.note(reason, self.peer_name)
        if self.transport is not None:
            self.transport.abort()

    @property
    def session(self) -> ViewerSession | None:
        """The session of the connection; None until a program has signed in."""
        session = None if self.processor is None else self.processor.session
        return session if isinstance(session, ViewerSession) and session.is_activated() else None


def forget_loggers() -> None:
    """Drop the loggers that asyncua makes for each subscription: the module logging would keep 2 kB for each,
    forever."""
    # Without this logger, their common name would have a list of them.
    logging.getLogger(LOGGERS.rstrip("."))
    known = logging.root.manager.loggerDict
    for name in [name for name in known if name.startswith(LOGGERS)]:
        del known[name]


@dataclass(eq=False)
class Gate:
    """The port of the OPC UA server, with its connections and their limits."""

    server: ViewerServer
    connections: list[GuardedConnection] = field(default_factory=list)
    closing: list[asyncio.Task[Any]] = field(default_factory=list)
    limits: TransportLimits = field(
        default_factory=lambda: TransportLimits(
            MAX_CHUNK, MAX_CHUNK, MAX_MESSAGE // MAX_CHUNK + 1, MAX_MESSAGE
        )
    )

    async def bind(self, host: str, port: int) -> asyncio.Server:
        """Take the port, for a server that does not listen yet. Raise OSError."""
        loop = asyncio.get_running_loop()
        return await loop.create_server(lambda: GuardedConnection(self), host, port, start_serving=False)

    async def sweep(self) -> None:
        """Close connections whose certificate or token is no longer valid, or whose session has ended, until
        canceled."""
        while True:
            await asyncio.sleep(SWEEP_S)
            self.server.trust.read()
            for connection in tuple(self.connections):
                self._judge(connection)
            self.closing[:] = [task for task in self.closing if not task.done()]
            forget_loggers()

    def _judge(self, connection: GuardedConnection) -> None:
        session, peer = connection.session, connection.policy.peer
        if peer is not None and not self.server.trust.trusts(peer):
            connection.refuse("BadCertificateUntrusted")
        elif session is None:
            if monotonic_now() - connection.made_at > SIGN_IN_S:
                connection.give_up("no session")
        elif session.key is None or not self.server.tokens.holds(session.key):
            connection.refuse("BadUserAccessDenied")

    def close(self) -> None:
        """Close all connections, and tell the clients that the server ends."""
        for connection in tuple(self.connections):
            connection.refuse("BadServerHalted")
