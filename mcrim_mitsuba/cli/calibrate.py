import click
@click.command()
def calibrate(): """soon"""
