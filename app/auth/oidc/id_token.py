"""Verifies an ID token (OpenID Connect Core, 3.1.3.7). Pure: time is passed in."""

from __future__ import annotations

import hmac
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
from joserfc import jws
from joserfc.errors import JoseError
from joserfc.jwk import ECKey, JWKRegistry, Key, OKPKey, RSAKey

from bus.instants import UnixTime

ALGORITHMS = (
    *("RS256", "RS384", "RS512", "PS256", "PS384", "PS512"),
    *("ES256", "ES384", "ES512", "EdDSA", "Ed25519"),
)
"""Signatures by a key that only the provider has: neither ``none``, nor by a secret that is shared."""
KEY_TYPES = ("RSA", "EC", "OKP")
LEEWAY_S = 60.0
"""How far the clocks of provider and server may differ."""
MAX_SUBJECT = 255
_REGISTRY = jws.JWSRegistry(algorithms=ALGORITHMS, strict_check_header=False)

KeyData = Mapping[str, Any]
Claims = Mapping[str, Any]


class InvalidTokenError(Exception):
    """The text is for the log: it holds nothing of the token but names."""


class UnknownKeyError(InvalidTokenError):
    """The token names a key that is none of those that are known: the provider may have a new one."""


@dataclass(frozen=True, slots=True)
class Expected:
    """What a token must be: of this issuer, for this client, for the attempt with this nonce."""

    issuer: str
    client_id: str
    nonce: str


def verified_claims(token: str, keys: Sequence[KeyData], expected: Expected, now: UnixTime) -> Claims:
    """The claims of a token. Raises InvalidTokenError."""
    claims = _signed_claims(token, keys)
    _check_parties(claims, expected)
    _check_times(claims, float(now))
    nonce = claims.get("nonce")
    if not isinstance(nonce, str) or not hmac.compare_digest(nonce.encode(), expected.nonce.encode()):
        raise InvalidTokenError("it is for another attempt: the nonce differs")
    subject = claims.get("sub")
    if not isinstance(subject, str) or not 0 < len(subject) <= MAX_SUBJECT:
        raise InvalidTokenError("it has no subject")
    return claims


def _signed_claims(token: str, keys: Sequence[KeyData]) -> Claims:
    try:
        signed = jws.extract_compact(token.encode(), registry=_REGISTRY)
        header = signed.headers()
        if header.get("alg") not in ALGORITHMS or "crit" in header:
            raise InvalidTokenError("it is not signed by an algorithm that is accepted")
        key = _key_of(header, keys)
        verified = jws.deserialize_compact(token.encode(), key, registry=_REGISTRY)
        claims: Any = msgspec.json.decode(verified.payload or b"")
    except (JoseError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise InvalidTokenError(f"its signature is not valid: {type(error).__name__}") from None
    if not isinstance(claims, dict):
        raise InvalidTokenError("it has no claims")
    return claims


def _key_of(header: Mapping[str, Any], keys: Sequence[KeyData]) -> Key:
    """The key that a token names; one without a name is of the only key of its type."""
    algorithm, name = header["alg"], header.get("kid")
    kind = "RSA" if algorithm[0] in "RP" else "OKP" if algorithm.startswith("Ed") else "EC"
    fitting = [
        each
        for each in keys
        if each.get("kty") == kind
        and each.get("use", "sig") == "sig"
        and each.get("alg", algorithm) == algorithm
        and (name is None or each.get("kid") == name)
    ]
    if not fitting or (name is None and len(fitting) > 1):
        raise UnknownKeyError("it is signed by a key that the provider does not name")
    key = JWKRegistry.import_key(dict(fitting[0]))
    assert isinstance(key, (RSAKey, ECKey, OKPKey))
    return key


def _check_parties(claims: Claims, expected: Expected) -> None:
    if claims.get("iss") != expected.issuer:
        raise InvalidTokenError("it is of another issuer")
    audience = claims.get("aud")
    audiences = [audience] if isinstance(audience, str) else audience
    if not isinstance(audiences, list) or expected.client_id not in audiences:
        raise InvalidTokenError("it is for another client")
    party = claims.get("azp")
    if (party is None and len(audiences) > 1) or (party is not None and party != expected.client_id):
        raise InvalidTokenError("it was issued to another client")


def _check_times(claims: Claims, now: float) -> None:
    expires, issued, begins = (_time_of(claims, name) for name in ("exp", "iat", "nbf"))
    if expires is None or issued is None:
        raise InvalidTokenError("it has no times")
    if now >= expires + LEEWAY_S:
        raise InvalidTokenError("it has expired; compare the clocks of server and provider")
    if max(issued, begins or 0.0) > now + LEEWAY_S:
        raise InvalidTokenError("it is of the future; compare the clocks of server and provider")


def _time_of(claims: Claims, name: str) -> float | None:
    value = claims.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InvalidTokenError(f"its time {name} is none")
    return float(value)
