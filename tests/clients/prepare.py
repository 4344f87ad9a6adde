"""Makes the environments of all clients. The gate does so while the compiler works, which leaves the network to it."""

import subprocess
import unittest

import test_madsci
import test_openapi
import test_python
import test_sila
import test_tables
import test_webhooks
from service import environment

for packages in (
    test_openapi.GENERATOR,
    test_python.PLAIN,
    test_python.ADAPTERS,
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
try:
    test_python.build.tools(test_python.build.TOOLS)
except subprocess.CalledProcessError:
    pass
