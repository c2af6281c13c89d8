"""HTTPS for the operator's page, with the host's certificate of the lab."""

import ssl
from pathlib import Path

from testbed.config import ConfigError, load
from testbed.console.server import ConsoleError
from testbed.logs.log_reader import LogError, config_of
from testbed.net.credentials import CERTIFICATE, KEY


def lab_certificate(run: Path) -> ssl.SSLContext | None:
    """TLS with the keys of the run's table file; None: it has none.

    Raises:
        ConsoleError: the keys cannot be used.
    """
    try:
        keys = load(config_of(run)).table.lab.network.keys
    except (ConfigError, LogError, OSError):
        return None
    if not keys:
        return None
    folder = Path(keys)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(folder / CERTIFICATE, folder / KEY)
    except OSError as error:  # ssl's errors, too
        raise ConsoleError(f"the lab's keys in {folder} cannot serve the page: {error}") from None
    return context
