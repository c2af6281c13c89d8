"""`testbed lab-keys`: make the lab's keys and the list of permissions in one command."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from testbed.net.certificate_authority import Wanted
    from testbed.net.credentials import Credentials

PORT = 7450
WORD = r"[A-Za-z0-9_-]{1,32}"


def words(context: click.Context, option: click.Parameter, given: Sequence[str]) -> tuple[str, ...]:
    """Validate names that become parts of key expressions and folder names."""
    import re

    for name in given:
        if not re.fullmatch(WORD, name):
            raise click.BadParameter(f"{name!r}; expected 1 to 32 letters, digits, - and _")
    return tuple(dict.fromkeys(given))


def hosts(context: click.Context, option: click.Parameter, given: Sequence[str]) -> tuple[str, ...]:
    """Validate host names and IP addresses for a certificate."""
    import ipaddress
    import re

    for name in given:
        try:
            ipaddress.ip_address(name)
        except ValueError:
            label = r"[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?"
            if len(name) > 253 or not re.fullmatch(rf"{label}(\.{label})*", name):
                raise click.BadParameter(
                    f"{name!r}; expected a host name or an IP address"
                ) from None
    return tuple(dict.fromkeys(given))


@click.command(name="lab-keys")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--host",
    multiple=True,
    callback=hosts,
    help="Name or address of the host; the first is the endpoint.",
)
@click.option("--vehicle", multiple=True, callback=words, help="Vehicle; may fly under this name.")
@click.option(
    "--operator", multiple=True, callback=words, help="Operator; may command, stop and watch."
)
@click.option("--watcher", multiple=True, callback=words, help="Watcher; may only watch.")
@click.option("--lab", callback=lambda c, o, v: words(c, o, [v])[0] if v else None,
              help="Name of the lab on the network.  [default: lab]")  # fmt: skip
@click.option("--port", type=click.IntRange(1, 65535), help=f"Port of the host.  [default: {PORT}]")
@click.option("--days", type=click.IntRange(1, 3650), default=365, show_default=True,
              help="Days until the keys expire.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace the named keys if they exist.")
@click.option("--renew", is_flag=True, help="Replace all keys; keep the certificate authority.")
@click.pass_context
def lab_keys(
    context: click.Context, folder: Path, host: tuple[str, ...], vehicle: tuple[str, ...],
    operator: tuple[str, ...], watcher: tuple[str, ...], lab: str | None, port: int | None,
    days: int, force: bool, renew: bool,
) -> None:  # fmt: skip
    """Make the lab's keys in FOLDER, or list the existing ones.

    See docs/lab_keys.md. Options that take a name may be repeated.

    \b
      testbed lab-keys keys --host 192.168.1.2 --vehicle sat1 --operator anna
      testbed lab-keys keys --watcher screen    adds one more later
      testbed lab-keys keys                     lists keys and expiry dates
    """  # noqa: D301
    from testbed.cli.exit_code import BAD_INPUT, OK
    from testbed.net.credentials import CredentialsError

    parties = [("vehicle", name) for name in vehicle]
    parties += [("operator", name) for name in operator] + [("watcher", name) for name in watcher]
    try:
        _make(folder, host, parties, (lab, port), days, force=force, renew=renew)
        context.exit(OK)
    except (CredentialsError, OSError) as error:
        from testbed.cli.refusal import refuse

        refuse(error)
    except ImportError as error:
        if error.name is None or not error.name.startswith("cryptography"):
            raise
        from testbed.core.extra import pip_install

        sys.stderr.write(
            "error: making keys needs the package cryptography, which is not installed:"
            f" {pip_install('keys')}; only the machine that makes keys needs it\n"
        )
    context.exit(BAD_INPUT)


def _make(
    folder: Path, host: Sequence[str], parties: list[tuple[str, str]],
    where: tuple[str | None, int | None], days: int, *, force: bool, renew: bool,
) -> None:  # fmt: skip
    from testbed.net.certificate_authority import host_credentials, listed, make_keys

    there, before = host_credentials(folder), listed(folder)
    if there is None:
        wanted = _first(folder, host, parties, where, days)
    else:
        all_before = [(party.role, party.name) for party in before]
        parties = list(dict.fromkeys([*all_before, *parties])) if renew else parties
        wanted = _more(folder, there, host, parties, where, days, renew=renew)
    if not wanted.parties:
        _show(folder, before)
        return
    _show(folder, make_keys(folder, wanted, force=force or renew))
    if there is None:
        _explain(folder, wanted.endpoint, wanted.lab)
    elif renew:
        sys.stdout.write(
            "\nCopy every folder to its machine again; old keys stay valid until they expire.\n"
        )
    else:
        sys.stdout.write(
            f"\nCopy {folder / 'host'} to the host again: its list of names has changed.\n"
        )


def _first(
    folder: Path, host: Sequence[str], parties: Sequence[tuple[str, str]],
    where: tuple[str | None, int | None], days: int,
) -> "Wanted":  # fmt: skip
    """The first keys of a lab: those of host and table, too."""
    from testbed.net.certificate_authority import Wanted
    from testbed.net.credentials import CredentialsError

    if not host:
        raise CredentialsError(f"there are no keys in {folder} yet; expected --host to make some")
    lab, port = where
    parties = [("host", "host"), ("table", "table"), *parties]
    return Wanted(lab or "lab", _endpoint(host[0], port or PORT), list(host), parties, days)


def _more(
    folder: Path, there: "Credentials", host: Sequence[str], parties: Sequence[tuple[str, str]],
    where: tuple[str | None, int | None], days: int, *, renew: bool,
) -> "Wanted":  # fmt: skip
    """More keys of a lab, or all of them again; a new address of the host needs all of them."""
    from testbed.net.certificate_authority import Wanted, addresses_of
    from testbed.net.credentials import CredentialsError

    lab, port = where
    if lab not in (None, there.lab):
        raise CredentialsError(f"the keys in {folder} are for the lab {there.lab!r}, not {lab!r}")
    addresses, endpoint = list(host) or addresses_of(folder), there.endpoint
    if (host or port) and not renew:
        raise CredentialsError(
            "the host has keys already; a new address changes every key folder, so it needs --renew"
        )
    if host or port:
        old_host, _, old_port = endpoint.removeprefix("tls/").rpartition(":")
        endpoint = _endpoint(host[0] if host else old_host.strip("[]"), port or int(old_port))
    return Wanted(there.lab, endpoint, addresses, parties, days)


def _endpoint(host: str, port: int) -> str:
    return f"tls/[{host}]:{port}" if ":" in host else f"tls/{host}:{port}"


def _show(folder: Path, parties: "Sequence[Credentials]") -> None:
    for party in parties:
        sys.stdout.write(
            f"{folder / party.common_name}  until {party.expires[:10]}\n"
            f"  SHA-256 {party.fingerprint}\n"
        )


def _explain(folder: Path, endpoint: str, lab: str) -> None:
    sys.stdout.write(
        "\nIn the table file:\n\n  [lab.network]\n"
        + (f'  lab = "{lab}"\n' if lab != "lab" else "")
        + f'  endpoint = "{endpoint}"\n  keys = "{(folder / "host").absolute()}"\n\n'
        "Copy each folder to its machine; keep the authority's folder off all machines that fly:\n"
        "  vehicle-*    testbed agent NAME --keys FOLDER\n"
        "  operator-*   ~/.airbearing-testbed, for: testbed stop\n"
    )
