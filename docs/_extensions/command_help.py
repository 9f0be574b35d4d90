"""The directive ``command-help``: what every command says of itself, word for word."""

import click
from sphinx.util.docutils import SphinxDirective

from mcrim_mitsuba.cli.main import mcrim

_WIDTH = 88


def sections(command: click.Command, name: str, above: click.Context | None, level: int):
    """Lines of Markdown: a section for the command, and for those under it."""
    context = command.make_context(
        name, [], parent=above, resilient_parsing=True, terminal_width=_WIDTH
    )
    yield from (f"{'#' * level} {context.command_path}", "")
    yield from ("```text", *command.get_help(context).splitlines(), "```", "")
    if isinstance(command, click.Group):
        for verb in command.list_commands(context):
            yield from sections(command.get_command(context, verb), verb, context, level + 1)


class CommandHelp(SphinxDirective):
    def run(self):
        lines = "\n".join(sections(mcrim, "mcrim", None, 2))
        return self.parse_text_to_nodes(lines, allow_section_headings=True)


def setup(app) -> dict[str, bool]:
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
