import click
@click.command()
def paper(): """soon"""
