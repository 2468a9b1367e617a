"""The page: it shows a tuner in browsers, and lets those who may steer it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from rclpy.executors import Executor
from rclpy.node import Node

from mobo_tuner.addresses import address
from mobo_tuner.client import TunerClient
from mobo_tuner.nodes.parameters import PAGE
from mobo_tuner.ros.parameters import declare, refuse_undeclared, take_given
from mobo_tuner.ros.process import Program, StartError, exit_process, run_node

if TYPE_CHECKING:
    from mobo_tuner.page.server import PageServer

TOKEN_VARIABLE = "MOBO_PAGE_TOKEN"
NICENESS = 15  # the run goes first
EXIT_ERROR = 1
PROGRAM = Program("page", "Shows a tuner in a browser, and lets operators steer it.", PAGE)


class Page:
    """Connects the node, the client and the web server; nothing moves until a viewer asks for it.

    rclpy works on the thread of this node's executor; the server has a thread and an event loop of its
    own, and takes over the messages from a queue.
    """

    def __init__(self, executor: Executor) -> None:
        """Begin to listen, and print the address.

        Raises:
            UserError: If a parameter is not allowed, or nobody can listen there.
            StartError: If the web framework is not installed.
        """
        self.node = Node("page", automatically_declare_parameters_from_overrides=True)
        self._client = TunerClient(node=self.node, executor=executor)
        try:
            given = take_given(self.node)
            parameters = declare(self.node, PAGE)
            refuse_undeclared(self.node, given)
            self._server = self._serve(parameters)
        except BaseException:
            self._client.close()
            self.node.destroy_node()
            raise

    def _serve(self, parameters: dict[str, object]) -> PageServer:
        try:
            from mobo_tuner.page.access import Access
            from mobo_tuner.page.feed import Feed
            from mobo_tuner.page.history import History
            from mobo_tuner.page.server import PageServer, listen
        except ModuleNotFoundError as error:
            raise StartError(
                f"{error.name} is not installed; the page needs: pip install 'mobo_tuner[page]'"
            ) from None
        host, port = str(parameters["host"]), int(str(parameters["port"]))
        access = Access(
            host,
            read_only=bool(parameters["read_only"]),
            token=os.environ.get(TOKEN_VARIABLE, ""),
        )
        listener = listen(host, port)
        folder = str(parameters["runs_dir"])
        server = PageServer(
            Feed(self.node),
            self._client,
            History(Path(folder) if folder else None),
            access,
            listener,
        )
        query = f"?token={access.token}" if access.token else ""
        print(f"page: {address('http', host, listener.getsockname()[1])}/{query}", flush=True)
        return server

    @property
    def exit_code(self) -> int | None:
        """1 if the server has failed; None while it serves."""
        return EXIT_ERROR if self._server.failed else None

    async def stop(self) -> None:
        """End the server."""
        self._server.stop()

    def close(self) -> None:
        """Release everything."""
        self._server.join()
        self._client.close()
        self.node.destroy_node()


def main() -> None:
    """Run the page until a signal stops it."""
    os.nice(NICENESS)
    exit_process(run_node(Page, PROGRAM))


if __name__ == "__main__":
    main()
