"""The dask scheduler of an existing cluster: its address, and the certificates of an encrypted connection.

Whoever reaches a scheduler can run any code on its workers, and reads the tasks on their way.  A plain connection is therefore
made on this machine only; elsewhere both sides show certificates of one authority (mutual TLS).
"""

from __future__ import annotations

import ipaddress
import socket
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from pipeline.errors import UsageError

if TYPE_CHECKING:
    from distributed import Security

_ALLOWED = "tcp://host:port of a running scheduler; tls://host:port with --tls-ca, --tls-cert and --tls-key"
#: Schemes of dask whose connections are encrypted; "inproc" does not leave the process.
_ENCRYPTED, _LOCAL = ("tls", "wss"), ("inproc",)


class UnreachableError(UsageError):
    """The scheduler does not answer: nothing was run."""


@dataclass(frozen=True)
class Scheduler:
    """Address of a scheduler; no ``security``: a plain connection, or certificates that dask's own settings name."""

    address: str
    security: Security | None = None


def scheduler_of(
    address: str | None,
    ca: Path | None = None,
    certificate: Path | None = None,
    key: Path | None = None,
    insecure: bool = False,
) -> Scheduler | None:
    """The scheduler that the options of a command name; ``None`` if they name none.

    Parameters
    ----------
    address : dask address; tcp:// means tls:// where certificates are given.
    ca, certificate, key : PEM files: the authority, and the certificate and the key of this client.
    insecure : allow a plain connection to another machine.

    Raises
    ------
    UsageError : options are missing or exclude each other, a file is no certificate, or the connection would be plain.
    """
    files = {"--tls-ca": ca, "--tls-cert": certificate, "--tls-key": key}
    given = [name for name, file in files.items() if file is not None]
    if address is None:
        _require(not (given or insecure), "TLS options without --scheduler", given or ["--insecure"], "add --scheduler")
        return None
    scheme, separator, rest = address.partition("://")
    if not separator:
        scheme, rest = "tcp", address
    if ca is not None and certificate is not None:
        _require(not insecure, "--insecure with certificates", address, "leave out --insecure")
        _require(scheme in ("tcp", *_ENCRYPTED), "certificates for a connection without TLS", address, "use tls://")
        encrypted = "tls" if scheme == "tcp" else scheme
        return Scheduler(f"{encrypted}://{rest}", _security(ca, certificate, key))
    _require(not given, f"{' and '.join(given)} alone", None, "give --tls-ca, --tls-cert and --tls-key")
    if scheme in _ENCRYPTED:
        import dask  # where it is needed: a run on this machine is checked without it

        named = all(dask.config.get(f"distributed.comm.tls.{name}") for name in ("ca-file", "client.cert"))
        _require(named, "no certificates for the scheduler", address, "give --tls-ca, --tls-cert and --tls-key")
    else:
        plain = insecure or scheme in _LOCAL or _on_this_machine(rest)
        what = "the connection to a scheduler on another machine would not be encrypted"
        step = (
            "start scheduler and workers with TLS (docs/how-to/cluster.md) and give --tls-ca, --tls-cert and --tls-key, "
            "or accept the risk with --insecure"
        )
        _require(plain, what, address, step)
    return Scheduler(f"{scheme}://{rest}")


def _require(condition: bool, what: str, value: object, next_step: str) -> None:
    if not condition:
        raise UsageError(what, value=value, allowed=_ALLOWED, next_step=next_step)


def _security(ca: Path, certificate: Path, key: Path | None) -> Security:
    from distributed import Security

    for file in (ca, certificate, key):
        if file is not None and not file.is_file():
            raise UsageError("no such file", value=str(file), allowed="a PEM file", next_step="correct the path")
    try:
        context = ssl.create_default_context(ssl.Purpose.SERVER_AUTH, cafile=str(ca))
        # An encrypted key would wait for a passphrase at the terminal.
        context.load_cert_chain(certificate, key, password="")
    except (OSError, ValueError) as error:
        raise UsageError(
            f"the certificates cannot be used ({getattr(error, 'reason', None) or error})",
            value=[str(file) for file in (ca, certificate, key) if file is not None],
            allowed="PEM files: an authority, a certificate, and its key without a passphrase",
            next_step="correct --tls-ca, --tls-cert and --tls-key",
        ) from None
    return Security(
        require_encryption=True,
        tls_ca_file=str(ca.absolute()),
        tls_client_cert=str(certificate.absolute()),
        tls_client_key=None if key is None else str(key.absolute()),
    )


def _on_this_machine(rest: str) -> bool:
    """Whether host:port leads to this machine only."""
    try:
        host = urlsplit(f"//{rest}").hostname or ""
        found = {str(entry[4][0]) for entry in socket.getaddrinfo(host, None)}
        return all(ipaddress.ip_address(address.partition("%")[0]).is_loopback for address in found)
    except (OSError, ValueError):
        return False
