"""Windows that travel: gateways cut them beside the machines, an MQTT broker carries them, scorers
judge and store them.

A gateway keeps a window on its disk until a scorer has said that it is stored, so neither the
broker nor a scorer has to keep anything: whatever is killed, the window is sent again, and its key
lets it be stored once.

    gateway → PREFIX/windows/PARTITION/GATEWAY/KEY → scorer → database
    scorer  → PREFIX/receipts/GATEWAY              → gateway
    scorer  → PREFIX/stored                        → service

A service is told no more than the name of a stored window and reads the finding from the store, so
that its live stream shows what scorers found.

A machine is always of the same one of `PARTITIONS`, and a partition of one scorer: its windows are
judged in their order.
"""
