"""Who may look at a race, and who may steer it.

A page of another site, open in the viewer's browser, can send requests to this machine. Two
headers give it away, which the browser writes and the page cannot change: ``Origin`` names
the other site, and ``Host`` names the site's own domain where that domain has been made to
point here (DNS rebinding).
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from urllib.parse import urlsplit

__all__ = ["Guard", "is_loopback"]


class Guard:
    """Judges the headers of requests.

    Args:
        host: the name or address that the page is served on.

    Attributes:
        key: who shows it may steer; empty if everybody may who can reach the page, which is
            so on the loopback address.
    """

    def __init__(self, host: str) -> None:
        self._host = host.lower()
        self.key = "" if is_loopback(host) else secrets.token_urlsafe(16)

    def knows_host(self, header: str | None) -> bool:
        """Whether a ``Host`` header is this page's: an address, ``localhost`` or its name."""
        name = _name_of(f"//{header}") if header else None
        if name is None:
            return False
        return name in ("localhost", self._host) or _address_of(name) is not None

    def knows_origin(self, origin: str | None, host: str | None) -> bool:
        """Whether a request comes from this page.

        Programs that are no browsers send no ``Origin``, and could send any.
        """
        if origin is None:
            return True
        return host is not None and origin.lower() == f"http://{host.lower()}"

    def may_steer(self, key: str) -> bool:
        """Whether somebody with this key may steer."""
        return hmac.compare_digest(key.encode(), self.key.encode()) or not self.key


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this machine only."""
    address = _address_of(host)
    return host.lower() == "localhost" or (address is not None and address.is_loopback)


def _name_of(url: str) -> str | None:
    try:
        parts = urlsplit(url)
        has_port = parts.port is None or parts.port >= 0
    except ValueError:
        return None
    is_plain = not (parts.username or parts.path or parts.query or parts.fragment)
    return parts.hostname if is_plain and has_port else None


def _address_of(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None
