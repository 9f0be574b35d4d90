"""``mcrim scenes``: what comes with the package, and copies of it to edit."""

from __future__ import annotations

import shlex
from pathlib import Path

import click


@click.command()
@click.option("-o", "--output", "folder", metavar="FOLDER",
              help="Copy all of them there, to be edited; replaces nothing.")  # fmt: skip
def scenes(folder) -> None:
    """List the scenes, campaigns and measurements that come with the package, or copy them."""
    from mcrim_mitsuba.scene.shipped import copy_scenes, scene_files, scenes_folder

    if folder is None:
        click.echo(f"in {scenes_folder()}:")
        for name in scene_files():
            click.echo(f"  {name.as_posix()}")
        return
    copies = copy_scenes(folder)
    scene = shlex.quote(str(Path(folder) / "camoo4.xml"))
    click.echo(f"{len(copies)} files were copied to {folder}. Next: mcrim check {scene}")
