"""Access control: the list of parties in the host's key folder, and Zenoh's rules made from it.

    role       publishes                   subscribes to              queries and answers
    host       everything: all other parties connect to it
    vehicle    its own state, message,     its setpoint; lease,       the host's clock, experiment;
               tick and event; liveliness  stop, poses; states and    gives the host its ticket;
                                           messages of other laws     answers orders and stop
    table      truth, poses
    operator   stop                        all that is published      stop; the experiment;
                                                                      vehicles that have ended
    watcher    nothing                     states, messages, ticks,   the host's experiment
                                           events, truth, poses,
                                           leases, liveliness

The host drops everything else silently: Zenoh sends no answer to a party without rights. Rights
belong to the certificate's common name, which is the role and the name.
"""

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
import zenoh
from msgspec import Struct

from testbed.core.lab import Network
from testbed.net.credentials import (
    ROLES,
    Credentials,
    CredentialsError,
    common_name,
    known,
    read_credentials,
)
from testbed.net.keys import Keys
from testbed.net.session import NetworkError, listen

ACCESS = "access.toml"

SAY = (("ingress", ("put", "delete")), ("egress", ("declare_subscriber",)))
HEAR = (
    ("ingress", ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query")),
    ("egress", ("put", "delete", "liveliness_token")),
)
ASK = (("ingress", ("query",)), ("egress", ("reply", "declare_queryable")))
ANSWER = (("ingress", ("declare_queryable", "reply")), ("egress", ("query",)))
LIVE = (("ingress", ("liveliness_token",)),)

Act = tuple[tuple[str, tuple[str, ...]], ...]


class Admitted(Struct, frozen=True, forbid_unknown_fields=True):
    """A party in the access list."""

    role: str
    name: str
    fingerprint: str
    expires: str


class Access(Struct, frozen=True, forbid_unknown_fields=True):
    """The access list of a lab, `access.toml`."""

    lab: str
    endpoint: str
    party: list[Admitted]

    @property
    def parties(self) -> list[Credentials]:
        """Every party on the list."""
        return [
            Credentials(self.lab, self.endpoint, p.role, p.name, p.fingerprint, p.expires)
            for p in self.party
        ]


def read_access(folder: Path) -> Access:
    """Read the access list in the host's key folder.

    Raises:
        CredentialsError: it is missing or cannot be read.
    """
    path = folder / ACCESS
    expected = "expected the list that `testbed lab-keys` keeps in the host's key folder"
    try:
        access = msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), Access)
    except OSError as error:
        raise CredentialsError(f"{path}: {error.strerror}; {expected}") from None
    except (ValueError, RecursionError) as error:  # not TOML, not UTF-8, or other fields
        raise CredentialsError(f"{path}: {error}; {expected}") from None
    for one in access.party:
        if one.role not in ROLES:
            raise CredentialsError(
                f"{path}: a role {one.role!r}; expected one of: {', '.join(ROLES)}"
            )
    return access


def permissions(
    party: Credentials, keys: Keys, vehicles: Iterable[str]
) -> list[tuple[Act, list[str]]]:
    """Which actions a party may do on which keys."""

    def of(names: Iterable[str], *words: str) -> list[str]:
        return [keys.of(name, word) for name in names for word in words]

    vehicles, own = list(vehicles), [party.name]
    seen = of(vehicles, "state", "message", "tick", "event", "alive")
    seen += [keys.truth, keys.pose, keys.lease, keys.host_alive]
    match party.role:
        case "host":
            return [(act, [keys.everything]) for act in (SAY, HEAR, ASK, ANSWER, LIVE)]
        case "vehicle":
            return [
                (SAY, of(own, "state", "message", "tick", "event")),
                (LIVE, of(own, "alive")),
                (HEAR, of(own, "alive")),  # is another vehicle using its name?
                (HEAR, [*of(own, "setpoint"), keys.lease, keys.stop, keys.pose]),
                (HEAR, of(vehicles, "state", "message")),
                (ASK, [*of(own, "roll"), keys.clock, keys.experiment]),
                (ANSWER, [*of(own, "order"), keys.stop]),
            ]
        case "table":
            return [(SAY, [keys.truth, keys.pose])]
        case "operator":
            return [
                (SAY, [keys.stop]),
                (ASK, [keys.stop, keys.experiment, keys.ended]),
                (HEAR, [*seen, *of(vehicles, "setpoint"), keys.stop]),
            ]
        case _:  # a watcher
            return [(HEAR, seen), (ASK, [keys.experiment])]


def control(access: Access, keys: Keys) -> dict[str, Any]:
    """Zenoh's access-control configuration; a party that is not on the list may do nothing."""
    vehicles = known(access.parties, "vehicle")
    rules: list[dict[str, Any]] = []
    subjects, policies = [], []
    for party in access.parties:
        name = common_name(party.role, party.name)
        own: list[str] = []
        for act, where in permissions(party, keys, vehicles):
            for flow, messages in act:
                if not where:
                    continue
                rule = f"{name} {len(own)}"
                own.append(rule)
                rules.append({
                    "id": rule, "permission": "allow", "flows": [flow],
                    "messages": list(messages), "key_exprs": where,
                })  # fmt: skip
        if own:
            subjects.append({"id": name, "cert_common_names": [name]})
            policies.append({"rules": own, "subjects": [name]})
    return {
        "enabled": True, "default_permission": "deny",
        "rules": rules, "subjects": subjects, "policies": policies,
    }  # fmt: skip


def open_lab(network: Network, vehicles: Iterable[str]) -> tuple[zenoh.Session, list[str]]:
    """Open the host's session on a lab's network; also returns warnings about expiring keys.

    Args:
        network: of the lab file.
        vehicles: the vehicles that will fly.

    Raises:
        NetworkError: the session cannot be opened, or a vehicle has no keys.
    """
    if not network.keys:
        return listen(network.endpoint), []
    folder = Path(network.keys)
    try:
        credentials = read_credentials(folder)
        if credentials.role != "host":
            raise CredentialsError(
                f"{folder} has the keys of {credentials.common_name}, expected the host's"
            )
        access = read_access(folder)
    except CredentialsError as error:
        raise NetworkError(str(error)) from None
    if access.lab != network.lab:
        raise NetworkError(
            f"{folder} is of the lab {access.lab!r}, and [lab.network] of {network.lab!r}"
        )
    missing = [name for name in vehicles if name not in known(access.parties, "vehicle")]
    if missing:
        raise NetworkError(
            f"no keys for {', '.join(missing)} in {folder / ACCESS}; expected every vehicle there:"
            f" testbed lab-keys {folder.parent} --vehicle {missing[0]}"
        )
    ends = [party.ending for party in access.parties]
    session = listen(network.endpoint, folder, control(access, Keys(network.lab)))
    return session, [words for words in ends if words]
