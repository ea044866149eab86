"""No circles of imports, those for type checking included."""

import grimp
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def circles() -> list[set[str]]:
    """Return the strongly connected components, of two modules or more, of all imports."""
    graph = grimp.build_graph("swarm", "sitl", cache_dir=None)
    names = sorted(graph.modules)
    index = {name: k for k, name in enumerate(names)}
    edges = [
        (index[name], index[other])
        for name in names
        for other in graph.find_modules_directly_imported_by(name)
    ]
    rows, columns = np.array(edges).T
    shape = (len(names), len(names))
    matrix = coo_array((np.ones(len(edges)), (rows, columns)), shape)
    number, labels = connected_components(matrix, directed=True, connection="strong")
    components = [{names[k] for k in np.flatnonzero(labels == one)} for one in range(number)]
    return [component for component in components if len(component) > 1]


def test_there_is_no_circle_of_imports():
    assert [sorted(circle) for circle in circles()] == []
