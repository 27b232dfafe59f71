#include "geometry/maxflow.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace toile {

namespace {

constexpr int TERMINAL = -1, ORPHAN = -2, NONE = -1;

}  // namespace

MaxFlow::MaxFlow(Eigen::Index nodes, const Edges& edges)
    : node_(static_cast<std::size_t>(nodes) + 1), arc_(2 * static_cast<std::size_t>(edges.rows())), edge_(arc_.size()),
      source_{1, 0, {}, {}, {}, 0, 0, false}, sink_{-1, 0, {}, {}, {}, 0, 0, false} {
    for (Eigen::Index e = 0; e < edges.rows(); ++e)
        for (int c = 0; c < 2; ++c) ++node_[static_cast<std::size_t>(edges(e, c)) + 1].first;
    for (std::size_t v = 1; v < node_.size(); ++v) node_[v].first += node_[v - 1].first;
    std::vector<int> place(static_cast<std::size_t>(nodes));
    for (std::size_t v = 0; v < place.size(); ++v) place[v] = node_[v].first;
    for (Eigen::Index e = 0; e < edges.rows(); ++e) {
        const int p = edges(e, 0), q = edges(e, 1);
        const int a = place[static_cast<std::size_t>(p)]++, b = place[static_cast<std::size_t>(q)]++;
        arc_[static_cast<std::size_t>(a)] = {0, q, b};
        arc_[static_cast<std::size_t>(b)] = {0, p, a};
        edge_[static_cast<std::size_t>(a)] = edge_[static_cast<std::size_t>(b)] = static_cast<int>(e);
    }
}

void MaxFlow::solve(bool level) {
    for (Tree* tree : {&source_, &sink_}) {
        tree->depth = 1;
        tree->frontier.clear();
        for (int v = 0; v < nodes(); ++v) {
            Node& node = node_[static_cast<std::size_t>(v)];
            if (tree->sign > 0) node.distance = 0;
            if (!(tree->sign * node.excess > 0)) continue;
            node.distance = tree->sign;
            node.parent = TERMINAL;
            node.current = node.first;
            tree->frontier.push_back(v);
        }
    }
    while (!source_.frontier.empty() && !sink_.frontier.empty()) grow(next_to_grow(level));
    sink_tree_is_complete_ = sink_.frontier.empty();
}

MaxFlow::Tree& MaxFlow::next_to_grow(bool level) {
    if (level && source_.depth != sink_.depth) return source_.depth < sink_.depth ? source_ : sink_;
    return source_.frontier.size() <= sink_.frontier.size() ? source_ : sink_;
}

/// Adds the next level to a tree, augmenting wherever it touches the other one.
void MaxFlow::grow(Tree& tree) {
    tree.growing = true;
    for (std::size_t k = 0; k < tree.frontier.size(); ++k) scan(tree, tree.frontier[k]);  // adoption may append
    tree.growing = false;
    tree.frontier.swap(tree.next);
    tree.next.clear();
    ++tree.depth;
}

void MaxFlow::scan(Tree& tree, int v) {
    const int level = tree.sign * tree.depth;
    Node& node = node_[static_cast<std::size_t>(v)];
    for (int a = node.first, end = arcs_end(v); a < end && node.distance == level;) {
        const Arc& arc = arc_[static_cast<std::size_t>(a)];
        Node& other = node_[static_cast<std::size_t>(arc.head)];
        if (tree.sign * other.distance > 0 || !(outward(tree, arc) > 0)) {
            ++a;
        } else if (other.distance == 0) {
            other.distance = level + tree.sign;
            other.parent = arc.reverse;
            other.current = other.first;
            tree.next.push_back(arc.head);
            ++a;
        } else {
            augment(tree.sign > 0 ? a : arc.reverse);  // then look at this arc again
        }
    }
}

/// Pushes what fits from source to sink along the trees and the arc `bridge` between them.
void MaxFlow::augment(int bridge) {
    Arc& arc = arc_[static_cast<std::size_t>(bridge)];
    Arc& back = arc_[static_cast<std::size_t>(arc.reverse)];
    const int s = back.head, t = arc.head;
    const double amount = std::min({arc.residual, room_to_root(source_, s), room_to_root(sink_, t)});
    arc.residual -= amount;
    back.residual += amount;
    push_to_root(source_, s, amount);
    push_to_root(sink_, t, amount);
    adopt(source_);
    adopt(sink_);
}

double MaxFlow::room_to_root(const Tree& tree, int v) const {
    double room = std::numeric_limits<double>::infinity();
    const Node* node = &node_[static_cast<std::size_t>(v)];
    while (node->parent != TERMINAL) {
        const Arc& up = arc_[static_cast<std::size_t>(node->parent)];
        room = std::min(room, inward(tree, up));
        node = &node_[static_cast<std::size_t>(up.head)];
    }
    return std::min(room, std::abs(node->excess));
}

void MaxFlow::push_to_root(Tree& tree, int v, double amount) {
    Node* node = &node_[static_cast<std::size_t>(v)];
    while (node->parent != TERMINAL) {
        Arc& up = arc_[static_cast<std::size_t>(node->parent)];
        Arc& down = arc_[static_cast<std::size_t>(up.reverse)];
        Arc& carrier = tree.sign > 0 ? down : up;
        Arc& opposite = tree.sign > 0 ? up : down;
        carrier.residual -= amount;
        opposite.residual += amount;
        if (carrier.residual == 0) make_orphan(tree, v);
        v = up.head;
        node = &node_[static_cast<std::size_t>(v)];
    }
    node->excess -= tree.sign * amount;
    if (node->excess == 0) make_orphan(tree, v);
}

void MaxFlow::make_orphan(Tree& tree, int v) {
    Node& node = node_[static_cast<std::size_t>(v)];
    node.parent = ORPHAN;
    const int distance = tree.sign * node.distance;
    if (static_cast<std::size_t>(distance) >= tree.orphan.size()) tree.orphan.resize(distance + 1, NONE);
    node.next = std::exchange(tree.orphan[static_cast<std::size_t>(distance)], v);
    tree.lowest_orphan = std::min(tree.lowest_orphan, distance);
    ++tree.waiting;
}

/// Nearest first, so that whatever lies nearer than the orphan in hand hangs on the root.
void MaxFlow::adopt(Tree& tree) {
    for (auto d = static_cast<std::size_t>(tree.lowest_orphan); tree.waiting > 0; ++d)
        while (tree.orphan[d] != NONE) {
            const int v = tree.orphan[d];
            tree.orphan[d] = node_[static_cast<std::size_t>(v)].next;
            --tree.waiting;
            settle_orphan(tree, v);
        }
    tree.lowest_orphan = std::numeric_limits<int>::max();
}

/// Finds a parent one step nearer; or moves the node away to where it may find one, its children orphaned; or frees it.
void MaxFlow::settle_orphan(Tree& tree, int v) {
    Node& node = node_[static_cast<std::size_t>(v)];
    const int begin = node.first, end = arcs_end(v), wanted = node.distance - tree.sign;
    if (wanted != 0)
        for (int a = node.current; a < end; ++a) {
            const Arc& arc = arc_[static_cast<std::size_t>(a)];
            if (node_[static_cast<std::size_t>(arc.head)].distance != wanted || !(inward(tree, arc) > 0)) continue;
            node.parent = node.current = a;
            return;
        }
    const int limit = tree.depth + tree.growing;
    int nearest = limit;   // distance of the best parent to be
    bool settled = false;  // as near as this orphan was, and itself no orphan: it hangs on the root
    for (int a = begin; a < end; ++a) {
        const Arc& arc = arc_[static_cast<std::size_t>(a)];
        const Node& other = node_[static_cast<std::size_t>(arc.head)];
        const int distance = tree.sign * other.distance;
        if (distance <= 0) continue;
        if (distance < nearest && inward(tree, arc) > 0) {
            nearest = distance;
            node.current = a;
            settled = other.distance == node.distance && other.parent != ORPHAN;
        }
        if (other.parent == arc.reverse) make_orphan(tree, arc.head);
    }
    if (nearest >= limit) {
        node.distance = 0;
        return;
    }
    node.distance = tree.sign * (nearest + 1);
    if (settled)
        node.parent = node.current;
    else
        make_orphan(tree, v);
    if (nearest + 1 == tree.depth) tree.frontier.push_back(v);
    if (nearest + 1 == tree.depth + 1) tree.next.push_back(v);
}

}  // namespace toile
