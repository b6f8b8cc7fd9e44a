"""``python -m facewright``: the command line where its script is not on the path."""

from facewright.cli.main import run

if __name__ == "__main__":
    run()
