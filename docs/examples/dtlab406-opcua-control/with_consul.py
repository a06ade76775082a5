"""Starts a server, named by its file, beside a Consul whose catalogue is empty: python with_consul.py FILE."""

import http.server
import os
import runpy
import sys
import threading


class Catalogue(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Length", "2")
        self.end_headers()
        self.wfile.write(b"{}")

    def log_message(self, *_):
        pass


consul = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Catalogue)
threading.Thread(target=consul.serve_forever, daemon=True).start()
os.environ |= {"CONSUL_HOST": "127.0.0.1", "CONSUL_PORT": str(consul.server_address[1])}
runpy.run_path(sys.argv[1], run_name="__main__")
