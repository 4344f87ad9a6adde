"""Makes the environments of all clients. The gate does so while the compiler works, which leaves the network to it."""

import unittest

import test_madsci
import test_openapi
import test_sila
import test_tables
import test_webhooks
from service import environment

for packages in (
    test_openapi.GENERATOR,
    test_madsci.MADSCI,
    test_sila.SILA2,
    test_sila.UNITELABS,
    test_sila.MADSCI,
    test_tables.ANALYST,
    test_webhooks.WEBHOOKS,
):
    try:
        environment(*packages)
    except unittest.SkipTest:
        pass
