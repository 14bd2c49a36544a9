"""BrokerMap: what a map of a broker's messages says of the broker itself."""

from __future__ import annotations

from residuum.service.broker import BrokerAddress, BrokerTls, broker_address, with_hidden_password
from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.strict_model import StrictModel


class BrokerMap(StrictModel):
    """How a broker is entered."""

    tls: BrokerTls | None = None

    def entered(self, url: str) -> BrokerAddress:
        """The broker at an address, entered as the map says; BadInput where that cannot be."""
        try:
            address = broker_address(url, self.tls)
        except ValueError as error:
            raise BadBusDescription(f"{with_hidden_password(url)}: {error}") from None
        if address.tls is not None:
            address.tls.context()  # what is wrong with its files is told here, not in a thread
        return address
