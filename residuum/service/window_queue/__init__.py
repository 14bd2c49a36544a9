"""Windows that travel: a gateway cuts them beside the machines and sends them to a service, which
judges and stores them.

A gateway keeps a window on its disk until the service has answered that it is stored: whatever is
killed or cut off, the window is sent again under its own `Idempotency-Key`, and is stored once. A
machine's windows are sent one after the other, in their order. What the service refuses for good is
set aside with its reason.

    spool → POST /api/v1/assets/ASSET/windows → database → 201 → out of the spool
"""
