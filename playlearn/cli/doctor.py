"""`playlearn doctor`."""

import argparse

from playlearn.cli.verb import Verb, add_json


def run(arguments: argparse.Namespace) -> int:
    from playlearn.doctor import doctor

    return doctor(json_output=arguments.json)


VERB = Verb("doctor", "show what this machine has, what is missing, and the command that mends it", run, add_json)
