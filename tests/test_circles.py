"""An implementation never imports its config: no module here imports, by any way, itself."""

import grimp


def test_nothing_is_imported_in_a_circle() -> None:
    """Imports inside functions count too: OGBench's configs import their environments there."""
    graph = grimp.build_graph("playlearn", cache_dir=None)
    for verbs in ("playlearn.api", "playlearn.gym"):  # the package only hands these on, when they are asked for
        graph.remove_import(importer="playlearn", imported=verbs)
    assert "playlearn.envs.ogbench.cube" in graph.find_modules_directly_imported_by("playlearn.envs.ogbench.config")
    circles = [
        (module, imported)
        for module in sorted(graph.modules)
        for imported in graph.find_modules_directly_imported_by(module)
        if graph.chain_exists(importer=imported, imported=module)
    ]
    assert circles == []
