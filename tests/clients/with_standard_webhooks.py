"""Receives one message of a webhook with the library of Standard Webhooks: `python with_standard_webhooks.py`.

Prints its port, reads the secret from standard input, and prints the message once the library has verified it.
"""

import http.server
import json
import sys

from standardwebhooks.webhooks import Webhook, WebhookVerificationError


class Receiver(http.server.BaseHTTPRequestHandler):
    def do_POST(self):
        body = self.rfile.read(int(self.headers["content-length"]))
        headers = {name.lower(): value for name, value in self.headers.items()}
        self.server.message = Webhook(self.server.secret).verify(body, headers)
        try:
            Webhook(self.server.secret).verify(body.replace(b"within", b"Within"), headers)
        except WebhookVerificationError:
            self.server.refused = True
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_):
        pass


server = http.server.HTTPServer(("127.0.0.1", 0), Receiver)
server.message, server.refused = None, False
print(server.server_port, flush=True)
server.secret = sys.stdin.readline().strip()
while server.message is None:
    server.handle_request()
print(json.dumps({"message": server.message, "refused": server.refused}), flush=True)
