"""DDS domains that tests have to themselves."""

import socket

#: Held until the process ends.
_held: list[socket.socket] = []
#: Not ROS 2's default of 0, nor those of the demo, nor those whose ports the system gives away.
_FIRST, _LAST = 10, 99
#: Port that stands for domain 0: who could bind a domain's port has the domain.
_PORT = 28000


def own_domain() -> int:
    """A domain that nobody else has who asks here, in this process or another one on this host, until this one ends.

    Raises:
        RuntimeError: where all of them are taken.
    """
    for domain in range(_FIRST, _LAST + 1):
        holder = socket.socket()
        try:
            holder.bind(("127.0.0.1", _PORT + domain))
        except OSError:
            holder.close()
            continue
        _held.append(holder)
        return domain
    raise RuntimeError(f"the DDS domains {_FIRST} to {_LAST} are all in use by other tests on this host")
