"""A motion-capture system that an installed package adds: an entry point of `testbed.mocap`.

The plug-in is a class or function. It is called with the `options` of [lab.mocap], and with `wire`,
the whole of that table, if it has a parameter of this name. What it returns is a `MocapSource`.
"""

import msgspec

from testbed.core import plugin
from testbed.core.lab import MOCAP_SYSTEMS, MocapWire
from testbed.mocap.exposure import Exposure, MocapSource


class PluggedSource:
    """A plug-in as a `MocapSource`; after a failure it has no poses, and `complaint` says why.

    The vehicle goes on to fly its chain then: without poses it is brought to rest.

    Raises:
        OSError: the plug-in cannot be made.
    """

    def __init__(self, wire: MocapWire) -> None:
        where = f"[lab.mocap] system = {wire.system!r}"
        self.complaint = ""
        self._where = where
        try:
            made = plugin.load(plugin.MOCAP, wire.system, MOCAP_SYSTEMS)
            options = msgspec.convert(
                wire.options, plugin.option_type(made, plugin.PROVIDED[plugin.MOCAP])
            )
            self._source: MocapSource = plugin.call(made, options, {"wire": wire})
        except (plugin.PluginError, msgspec.ValidationError) as error:
            raise OSError(f"{where}: {error}") from error
        except Exception as error:  # a plug-in may raise anything
            raise OSError(f"{where} cannot be used: {type(error).__name__}: {error}") from error

    def poll(self) -> list[Exposure]:
        """See `MocapSource`."""
        try:
            return self._source.poll()
        except Exception as error:
            self.complaint = f"{self._where} failed: {type(error).__name__}: {error}"
            return []

    def close(self) -> None:
        """See `MocapSource`."""
        self._source.close()
