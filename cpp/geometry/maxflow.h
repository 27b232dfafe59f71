// Minimum s-t cut on a sparse graph, by incremental breadth-first search from both terminals.
#pragma once
#include <vector>

#include "base/types.h"

namespace toile {

/// Goldberg, Hed, Kaplan, Tarjan, Werneck, "Maximum Flows by Incremental Breadth-First Search" (ESA 2011).
///
/// The graph is fixed; capacities are set anew before each `solve`, which uses them up. Each edge is a pair of arcs;
/// parallel edges are welcome. Capacities must be multiples of one power of two and sum to less than 2^53 of it at
/// each node: then every sum is exact, each augmentation saturates an arc exactly, and termination is that of integers.
class MaxFlow {
public:
    MaxFlow(Eigen::Index nodes, const Edges& edges);

    int nodes() const { return static_cast<int>(node_.size()) - 1; }
    int arcs_begin(int v) const { return node_[static_cast<std::size_t>(v)].first; }
    int arcs_end(int v) const { return node_[static_cast<std::size_t>(v) + 1].first; }
    int head(int arc) const { return arc_[static_cast<std::size_t>(arc)].head; }
    int edge(int arc) const { return edge_[static_cast<std::size_t>(arc)]; }  ///< the edge that this arc is half of

    /// Capacity from the source to v when positive, from v to the sink when negative.
    void set_terminal(int v, double capacity) { node_[static_cast<std::size_t>(v)].excess = capacity; }
    void set_arc(int arc, double capacity) { arc_[static_cast<std::size_t>(arc)].residual = capacity; }

    /// `level`: both trees grow to the same depth, which keeps their branches short where much is to flow; else the one
    /// with fewer nodes at its front grows, which is soon done where little is.
    void solve(bool level = false);
    /// After `solve`, what flows along an arc of an edge that has the same capacity both ways.
    double flow(int arc) const {
        const Arc& there = arc_[static_cast<std::size_t>(arc)];
        return 0.5 * (arc_[static_cast<std::size_t>(there.reverse)].residual - there.residual);
    }
    bool source_side(int v) const {  ///< after `solve`: the side of v in one minimum cut
        const int d = node_[static_cast<std::size_t>(v)].distance;
        return sink_tree_is_complete_ ? d >= 0 : d > 0;
    }

private:
    struct Arc {
        double residual;
        int head, reverse;
    };
    struct Node {
        double excess = 0;  // what is left of the terminal's capacity, signed
        int distance = 0;   // from the source in its tree, minus the distance to the sink in the other, 0 when free
        int parent = 0;     // arc from this node to its parent, or TERMINAL, or ORPHAN
        int current = 0;    // arcs before this one lead to no parent at this distance
        int first = 0;      // first arc
        int next = 0;       // of the orphans at its distance, the one that waits behind it
    };
    /// What grows from one terminal; `sign` times a distance is positive in its tree.
    struct Tree {
        int sign, depth;
        std::vector<int> frontier, next;  // nodes of distance depth, and depth + 1 while growing
        std::vector<int> orphan;          // by distance, the one to settle next, or NONE
        int lowest_orphan, waiting;       // where the first of them are, and how many in all
        bool growing;
    };

    Tree& next_to_grow(bool level);
    void grow(Tree& tree);
    void scan(Tree& tree, int v);
    void augment(int bridge);
    void push_to_root(Tree& tree, int v, double amount);
    double room_to_root(const Tree& tree, int v) const;
    void make_orphan(Tree& tree, int v);
    void adopt(Tree& tree);
    void settle_orphan(Tree& tree, int v);
    /// Residual of the arc that carries flow away from the tree's root when `arc` leads away from the tree's node.
    double outward(const Tree& tree, const Arc& arc) const {
        return tree.sign > 0 ? arc.residual : arc_[static_cast<std::size_t>(arc.reverse)].residual;
    }
    double inward(const Tree& tree, const Arc& arc) const {
        return tree.sign > 0 ? arc_[static_cast<std::size_t>(arc.reverse)].residual : arc.residual;
    }

    std::vector<Node> node_;  // one more than there are nodes: the last holds the end of the arcs
    std::vector<Arc> arc_;
    std::vector<int> edge_;
    Tree source_, sink_;
    bool sink_tree_is_complete_ = false;
};

}  // namespace toile
