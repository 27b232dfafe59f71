#include "kernels/mrf.h"

#include <algorithm>
#include <cmath>

#include "base/errors.h"
#include "base/parallel.h"
#include "geometry/maxflow.h"

namespace toile {

namespace {

constexpr int START_ROUNDS = 10;
constexpr std::int64_t GRAIN = 131072;  // nodes: a loop over fewer is done sooner than a thread of a busy machine wakes
constexpr std::size_t MOST_FLOWS = 1 << 27;  // half a gigabyte

std::string at(const char* name, Eigen::Index i) { return std::string(name) + "[" + std::to_string(i) + "]"; }
std::string at(const char* name, Eigen::Index i, Eigen::Index j) {
    return std::string(name) + "[" + std::to_string(i) + ", " + std::to_string(j) + "]";
}

void check_metric(const Matrix& V, Eigen::Index labels) {
    require(V.rows() == labels && V.cols() == labels, "mrf: pairwise has shape (" + std::to_string(V.rows()) + ", " +
                                                          std::to_string(V.cols()) + "), unary has " +
                                                          std::to_string(labels) + " labels");
    check_finite("mrf", "pairwise", V);
    const double tolerance = 1e-9 * V.cwiseAbs().maxCoeff();
    for (Eigen::Index a = 0; a < labels; ++a) {
        require(V(a, a) == 0, "mrf: " + at("pairwise", a, a) + " is " + std::to_string(V(a, a)) + ", expected 0");
        for (Eigen::Index b = 0; b < labels; ++b) {
            require(V(a, b) >= 0, "mrf: " + at("pairwise", a, b) + " is negative");
            require(V(a, b) == V(b, a), "mrf: " + at("pairwise", a, b) + " differs from " + at("pairwise", b, a));
        }
    }
    for (Eigen::Index a = 0; a < labels; ++a)
        for (Eigen::Index b = 0; b < labels; ++b)
            for (Eigen::Index c = 0; c < labels; ++c)
                if (V(a, b) > V(a, c) + V(c, b) + tolerance)
                    throw InputError("mrf: pairwise is no metric: " + at("pairwise", a, b) + " exceeds " +
                                     at("pairwise", a, c) + " + " + at("pairwise", c, b));
}

void check_votes(const char* name, const Edges& votes, const Matrix& unary) {
    for (Eigen::Index k = 0; k < votes.rows(); ++k)
        require(votes(k, 0) >= 0 && votes(k, 0) < unary.rows() && votes(k, 1) >= 0 && votes(k, 1) < unary.cols(),
                "mrf: " + at(name, k) + " is (" + std::to_string(votes(k, 0)) + ", " + std::to_string(votes(k, 1)) +
                    "), unary has " + std::to_string(unary.rows()) + " nodes and " + std::to_string(unary.cols()) +
                    " labels");
}

void check_input(const Matrix& unary, const Edges& edges, const Vector& weights, const MrfOptions& options) {
    require(unary.rows() > 0 && unary.cols() > 0, "mrf: unary is empty");
    check_finite("mrf", "unary", unary);
    require(std::isfinite(unary.cwiseAbs().sum()), "mrf: the sum of unary overflows");
    require(weights.size() == edges.rows(), "mrf: weights has " + std::to_string(weights.size()) +
                                                " entries, edges has " + std::to_string(edges.rows()) + " rows");
    for (Eigen::Index e = 0; e < edges.rows(); ++e) {
        const int p = edges(e, 0), q = edges(e, 1);
        if (p < 0 || p >= unary.rows() || q < 0 || q >= unary.rows())
            throw InputError("mrf: " + at("edges", e) + " is (" + std::to_string(p) + ", " + std::to_string(q) +
                             "), unary has " + std::to_string(unary.rows()) + " nodes");
        if (p == q) throw InputError("mrf: " + at("edges", e) + " joins node " + std::to_string(p) + " to itself");
        if (!std::isfinite(weights[e])) throw InputError("mrf: " + at("weights", e) + " is not finite");
        if (weights[e] < 0) throw InputError("mrf: " + at("weights", e) + " is negative");
    }
    require(options.start.size() == 0 || options.start.size() == unary.rows(),
            "mrf: start has " + std::to_string(options.start.size()) + " labels, unary has " +
                std::to_string(unary.rows()) + " nodes");
    check_indices("mrf", "start", options.start, unary.cols());
    check_votes("prefer", options.prefer, unary);
    check_votes("forbid", options.forbid, unary);
    require(options.max_sweeps >= 0, "mrf: max_sweeps is negative");
    require(std::isfinite(options.vote_cost) && options.vote_cost >= 0, "mrf: vote_cost is negative or not finite");
    const Eigen::Index votes = (options.prefer.rows() + options.forbid.rows() + 1) * unary.cols();
    require(std::isfinite(options.vote_cost * static_cast<double>(votes)), "mrf: the sum of vote_cost overflows");
}

/// The energy, and moves that lower it.
class Field {
public:
    Field(const Matrix& unary, const Edges& edges, const Vector& weights, const Matrix& pairwise,
          const MrfOptions& options)
        : unary_(unary), V_(pairwise), edges_(edges), weights_(weights), flow_(unary.rows(), edges),
          arc_weight_(2 * static_cast<std::size_t>(edges.rows())), flow_of_(static_cast<std::size_t>(unary.cols())),
          x(unary.rows()) {
        for (int v = 0; v < flow_.nodes(); ++v)
            for (int a = flow_.arcs_begin(v); a < flow_.arcs_end(v); ++a)
                arc_weight_[static_cast<std::size_t>(a)] = weights[flow_.edge(a)];
        add_votes(options);
        choose_grid();
        if (options.start.size() > 0)
            x = options.start;
        else
            choose_start();
    }

    double unary_energy() const {
        return parallel_sum(x.size(), 0.0, [&](double& sum, std::int64_t v) { sum += unary_(v, x[v]); }, GRAIN);
    }
    double pairwise_energy() const {
        return parallel_sum(edges_.rows(), 0.0, [&](double& sum, std::int64_t e) {
            sum += weights_[e] * V_(x[edges_(e, 0)], x[edges_(e, 1)]);
        }, 2 * GRAIN);
    }

    /// The best of all moves in which any set of nodes changes to `alpha`; true when it lowers the energy.
    bool expand(int alpha) {
        load(alpha);
        flow_.solve(flow_of_[static_cast<std::size_t>(alpha)].empty());
        keep_flow(alpha);
        changed_.clear();
        for (int v = 0; v < flow_.nodes(); ++v)
            if (x[v] != alpha && !flow_.source_side(v)) changed_.push_back(v);
        if (changed_.empty() || !lowers(alpha)) return false;
        for (const int v : changed_) x[v] = alpha;
        return true;
    }

private:
    /// What a node can pay at most for one of its labels rather than another, doubled.
    double stake(Eigen::Index v) const {
        double sum = 1;
        for (int a = flow_.arcs_begin(static_cast<int>(v)); a < flow_.arcs_end(static_cast<int>(v)); ++a)
            sum += arc_weight_[static_cast<std::size_t>(a)] * V_.maxCoeff();
        return 2 * (sum + unary_.row(v).maxCoeff() - unary_.row(v).minCoeff());
    }

    void add_votes(const MrfOptions& options) {
        std::vector<double> cost(static_cast<std::size_t>(unary_.rows()), options.vote_cost);
        if (options.vote_cost == 0)
            for (const Edges* votes : {&options.prefer, &options.forbid})
                for (Eigen::Index k = 0; k < votes->rows(); ++k) cost[(*votes)(k, 0)] = stake((*votes)(k, 0));
        for (Eigen::Index k = 0; k < options.prefer.rows(); ++k) {
            const int v = options.prefer(k, 0), label = options.prefer(k, 1);
            for (Eigen::Index l = 0; l < unary_.cols(); ++l)
                if (l != label) unary_(v, l) += cost[static_cast<std::size_t>(v)];
        }
        for (Eigen::Index k = 0; k < options.forbid.rows(); ++k)
            unary_(options.forbid(k, 0), options.forbid(k, 1)) += cost[static_cast<std::size_t>(options.forbid(k, 0))];
    }

    /// Capacities become whole multiples of `1 / scale_`, small enough that their sums at a node are exact.
    void choose_grid() {
        double largest = 0;
        for (int v = 0; v < flow_.nodes(); ++v) {
            double sum = 0;
            for (int a = flow_.arcs_begin(v); a < flow_.arcs_end(v); ++a)
                sum += arc_weight_[static_cast<std::size_t>(a)];
            largest = std::max(largest, sum);
        }
        largest *= V_.maxCoeff();
        require(std::isfinite(largest), "mrf: the weights of one node sum to infinity");
        require(largest == 0 || largest > 1e-280, "mrf: the weights of every node sum to less than 1e-280");
        scale_ = largest > 0 ? std::ldexp(1.0, 49 - std::ilogb(largest)) : 1;
    }

    /// The cheapest label of each node by itself; then of each node given its neighbours, until that settles.
    void choose_start() {
        parallel_for(x.size(), [&](std::int64_t v) { unary_.row(v).minCoeff(&x[v]); }, GRAIN);
        Eigen::RowVectorXd cost(unary_.cols());
        std::vector<char> stale(static_cast<std::size_t>(x.size()), 1);
        bool changing = true;
        for (int round = 0; changing && round < START_ROUNDS; ++round) {
            changing = false;
            for (int v = 0; v < flow_.nodes(); ++v) {
                if (!stale[static_cast<std::size_t>(v)]) continue;
                stale[static_cast<std::size_t>(v)] = 0;
                cost = unary_.row(v);
                for (int a = flow_.arcs_begin(v); a < flow_.arcs_end(v); ++a)
                    cost += arc_weight_[static_cast<std::size_t>(a)] * V_.row(x[flow_.head(a)]);
                Eigen::Index best;
                cost.minCoeff(&best);
                if (best == x[v]) continue;
                x[v] = static_cast<int>(best);
                changing = true;
                for (int a = flow_.arcs_begin(v); a < flow_.arcs_end(v); ++a)
                    stale[static_cast<std::size_t>(flow_.head(a))] = 1;
            }
        }
    }

    /// What flowed along each edge when `alpha` was last tried: nearly what will flow when it is tried again.
    void keep_flow(int alpha) {
        if (flow_of_.size() * arc_weight_.size() > MOST_FLOWS) return;
        auto& kept = flow_of_[static_cast<std::size_t>(alpha)];
        kept.resize(static_cast<std::size_t>(edges_.rows()));
        parallel_for(flow_.nodes(), [&](std::int64_t v) {
            for (int a = flow_.arcs_begin(static_cast<int>(v)); a < flow_.arcs_end(static_cast<int>(v)); ++a)
                if (v < flow_.head(a)) kept[static_cast<std::size_t>(flow_.edge(a))] = flow_.flow(a);
        }, GRAIN);
    }

    /// A node on the source side keeps its label, one on the sink side takes alpha. With A = V(x_p, x_q) for neither,
    /// B = V(x_p, alpha) and C = V(alpha, x_q) for one, and 0 for both changed, each arc gets half of B + C - A, and
    /// what remains is linear: C - A - B, halved, for p.
    /// The search starts from the flow kept for alpha, cut down to the capacities of now.
    void load(int alpha) {
        const double half = 0.5 * scale_;
        const auto& kept = flow_of_[static_cast<std::size_t>(alpha)];
        parallel_for(flow_.nodes(), [&](std::int64_t i) {
            const int p = static_cast<int>(i), keep = x[p];
            const double B = V_(keep, alpha);
            double linear = 0, sum = 0, outflow = 0;
            for (int a = flow_.arcs_begin(p); a < flow_.arcs_end(p); ++a) {
                const double w = half * arc_weight_[static_cast<std::size_t>(a)];
                const int other = x[flow_.head(a)];
                const double A = V_(keep, other), C = V_(alpha, other);
                const double capacity = std::nearbyint(std::max(0.0, w * ((B + C) - A)));
                double along = kept.empty() ? 0 : kept[static_cast<std::size_t>(flow_.edge(a))];
                along = std::clamp(p < flow_.head(a) ? along : -along, -capacity, capacity);
                flow_.set_arc(a, capacity - along);
                outflow += along;
                sum += capacity;
                linear += w * (C - A - B);
            }
            // Beyond the sum of its arcs a terminal decides by itself, however large it is.
            const double preference = scale_ * (unary_(p, alpha) - unary_(p, keep)) + linear;
            const double terminal = std::nearbyint(std::clamp(preference, -sum - 1, sum + 1));
            flow_.set_terminal(p, (keep == alpha ? 0 : terminal) - outflow);
        }, GRAIN);
    }

    /// Does the energy fall when the nodes in `changed_` take alpha?
    bool lowers(int alpha) {
        moved_.assign(static_cast<std::size_t>(x.size()), 0);
        for (const int v : changed_) moved_[static_cast<std::size_t>(v)] = 1;
        double gain = 0, size = 0;
        const auto add = [&](double before, double after) {
            gain += before - after;
            size += std::abs(before - after);
        };
        for (const int p : changed_) {
            add(unary_(p, x[p]), unary_(p, alpha));
            for (int a = flow_.arcs_begin(p); a < flow_.arcs_end(p); ++a) {
                const int q = flow_.head(a);
                const double w = arc_weight_[static_cast<std::size_t>(a)];
                if (!moved_[static_cast<std::size_t>(q)])
                    add(w * V_(x[p], x[q]), w * V_(alpha, x[q]));
                else if (p < q)
                    add(w * V_(x[p], x[q]), 0);
            }
        }
        return gain > 1e-12 * size;
    }

    Matrix unary_, V_;
    Edges edges_;
    Vector weights_;
    MaxFlow flow_;
    std::vector<double> arc_weight_;
    std::vector<std::vector<double>> flow_of_;  // per label, along each edge from its lower node; empty at first
    double scale_ = 1;
    std::vector<int> changed_;
    std::vector<char> moved_;

public:
    Indices x;  ///< the labels
};

}  // namespace

MrfResult mrf(const Matrix& unary, const Edges& edges, const Vector& weights, const Matrix& pairwise,
              const MrfOptions& options) {
    check_input(unary, edges, weights, options);
    const auto labels = static_cast<int>(unary.cols());
    Matrix V = pairwise;
    if (pairwise.size() == 0) V = Matrix::Ones(labels, labels) - Matrix::Identity(labels, labels);
    check_metric(V, labels);
    Field field(unary, edges, weights, V, options);

    MrfResult result;
    result.sweep_energy.push_back(field.unary_energy() + field.pairwise_energy());
    int idle = 0;  // expansions in a row that changed nothing
    while (idle < labels && result.sweeps < options.max_sweeps) {
        for (int alpha = 0; alpha < labels && idle < labels; ++alpha) {
            idle = field.expand(alpha) ? 1 : idle + 1;  // right after its own expansion a label has nothing to gain
            ++result.expansions;
        }
        ++result.sweeps;
        result.sweep_energy.push_back(field.unary_energy() + field.pairwise_energy());
    }
    result.stop = idle >= labels ? Stop::converged : Stop::max_iterations;
    result.labels = field.x;
    result.unary_energy = field.unary_energy();
    result.pairwise_energy = field.pairwise_energy();
    result.energy = result.unary_energy + result.pairwise_energy;
    check_solved("mrf", "energy", Matrix::Constant(1, 1, result.energy));
    return result;
}

}  // namespace toile
