//! Circles and layers of a graph.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

use petgraph::algo::{condensation, tarjan_scc};
use petgraph::graph::{DiGraph, NodeIndex};

/// Arrows between nodes, which are numbers from 0.
pub(crate) struct Graph(DiGraph<usize, ()>);

impl Graph {
    pub(crate) fn new(nodes: usize, arrows: impl IntoIterator<Item = (usize, usize)>) -> Self {
        let mut graph = DiGraph::new();
        let nodes: Vec<NodeIndex> = (0..nodes).map(|node| graph.add_node(node)).collect();
        for (from, to) in arrows {
            graph.update_edge(nodes[from], nodes[to], ());
        }
        Self(graph)
    }

    /// Groups of nodes that reach each other, more than one in each, ascending.
    pub(crate) fn circles(&self) -> Vec<Vec<usize>> {
        let groups = tarjan_scc(&self.0).into_iter().filter(|group| group.len() > 1);
        let mut groups: Vec<Vec<usize>> = groups
            .map(|group| {
                let mut group: Vec<usize> = group.into_iter().map(NodeIndex::index).collect();
                group.sort_unstable();
                group
            })
            .collect();
        groups.sort_unstable();
        groups
    }

    /// The shortest way from a node of the group back to itself, without the node again at the end.
    pub(crate) fn shortest(&self, group: &[usize]) -> Vec<usize> {
        group.iter().filter_map(|node| self.back(*node)).min_by_key(Vec::len).unwrap_or_default()
    }

    fn back(&self, start: usize) -> Option<Vec<usize>> {
        let mut before: BTreeMap<usize, usize> = BTreeMap::new();
        let mut queue = VecDeque::from([start]);
        while let Some(node) = queue.pop_front() {
            let mut next: Vec<usize> =
                self.0.neighbors(NodeIndex::new(node)).map(NodeIndex::index).collect();
            next.sort_unstable();
            for next in next {
                if next == start {
                    let mut way = vec![node];
                    while let Some(previous) = way.last().and_then(|node| before.get(node)) {
                        way.push(*previous);
                    }
                    way.reverse();
                    return Some(way);
                }
                if let Entry::Vacant(unseen) = before.entry(next) {
                    unseen.insert(node);
                    queue.push_back(next);
                }
            }
        }
        None
    }

    /// Groups of nodes, lowest first: each layer points at lower layers alone. A group has more
    /// than one node where there is a circle.
    pub(crate) fn layers(&self) -> Vec<BTreeSet<Vec<usize>>> {
        let groups = condensation(self.0.clone(), true);
        // The condensation's nodes come with what they point at first.
        let order = petgraph::algo::toposort(&groups, None).unwrap_or_default();
        let mut heights: BTreeMap<NodeIndex, usize> = BTreeMap::new();
        let mut layers: Vec<BTreeSet<Vec<usize>>> = Vec::new();
        for node in order.into_iter().rev() {
            let below = groups.neighbors(node).filter_map(|next| heights.get(&next)).max();
            let height = below.map_or(0, |below| below + 1);
            heights.insert(node, height);
            layers.resize(layers.len().max(height + 1), BTreeSet::new());
            let mut group = groups[node].clone();
            group.sort_unstable();
            layers[height].insert(group);
        }
        layers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn circles_and_the_shortest_way_around() {
        let graph = Graph::new(7, [(0, 1), (1, 2), (2, 0), (2, 3), (3, 2), (4, 0), (5, 6), (6, 5)]);
        assert_eq!(graph.circles(), [vec![0, 1, 2, 3], vec![5, 6]]);
        assert_eq!(graph.shortest(&[0, 1, 2, 3]), [2, 3]);
        assert_eq!(graph.shortest(&[5, 6]), [5, 6]);
        let line = Graph::new(3, [(0, 1), (1, 2), (0, 2)]);
        assert_eq!(line.circles(), [[0; 0]; 0]);
        assert_eq!(line.shortest(&[0]), [0; 0]);
    }

    #[test]
    fn layers_point_down() {
        let graph = Graph::new(5, [(0, 1), (1, 2), (0, 2), (3, 4), (4, 3), (3, 2)]);
        let layer = |groups: &[&[usize]]| groups.iter().map(|group| group.to_vec()).collect();
        assert_eq!(graph.layers(), [layer(&[&[2]]), layer(&[&[1], &[3, 4]]), layer(&[&[0]])]);
    }
}
