"""A socket of a server on this computer, and the names by which it is known."""

from __future__ import annotations

import ipaddress
import socket

from ambrose.core.checks import InvalidInput


def listening(address: str, port: int) -> socket.socket:
    """A socket that listens at an address of this computer. Raises InvalidInput."""
    try:
        place = ipaddress.ip_address(address)
    except ValueError:
        raise InvalidInput(
            f"--listen is {address!r}, but must be an IP address of this computer, such as "
            "192.168.0.10; look it up in its network settings"
        ) from None
    if place.is_unspecified:
        raise InvalidInput(
            f"--listen {address} means every network at once; give the address of the one that "
            "may see the workbench"
        )
    family = socket.AF_INET6 if place.version == 6 else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.bind((address, port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise InvalidInput(
            f"cannot listen at {address}, port {port}: {error.strerror or error}; give another"
        ) from error
    return listener


def names_of(listener: socket.socket) -> list[str]:
    """ "address:port" by which a server at this socket is known; its own address first."""
    address, port = listener.getsockname()[:2]
    place = ipaddress.ip_address(address)
    own = f"[{address}]:{port}" if place.version == 6 else f"{address}:{port}"
    return [own, f"localhost:{port}"] if place.is_loopback else [own]
