#include "kernels/inner.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <queue>

#include "base/errors.h"
#include "base/parallel.h"
#include "base/sparse.h"
#include "geometry/laplacian.h"
#include "geometry/topology.h"
#include "kernels/inner/displacement.h"
#include "kernels/inner/rooms.h"

namespace toile {

namespace {

/// Distances (n,) [m] along the edges from the vertices that are not visible, up to `most` (Dijkstra); kNone beyond.
Vector from_hidden(const Vector& visible, const Adjacency& neighbours, const Vertices& V, double most) {
    const Eigen::Index n = visible.size();
    Vector distance = Vector::Constant(n, kNone);
    std::priority_queue<std::pair<double, int>, std::vector<std::pair<double, int>>, std::greater<>> queue;
    for (Eigen::Index v = 0; v < n; ++v) {
        if (visible[v] >= 0.5) continue;
        distance[v] = 0;
        const auto begin = neighbours.index.begin();
        const bool edge = std::any_of(begin + neighbours.start[v], begin + neighbours.start[v + 1],
                                      [&](int w) { return visible[w] >= 0.5; });
        if (edge) queue.emplace(0.0, static_cast<int>(v));
    }
    while (!queue.empty()) {
        const auto [d, v] = queue.top();
        queue.pop();
        if (d > distance[v]) continue;
        for (int e = neighbours.start[static_cast<std::size_t>(v)];
             e < neighbours.start[static_cast<std::size_t>(v) + 1]; ++e) {
            const int w = neighbours.index[static_cast<std::size_t>(e)];
            const double next = d + (V.row(v) - V.row(w)).norm();
            if (next >= distance[w] || next > most) continue;
            distance[w] = next;
            queue.emplace(next, w);
        }
    }
    return distance;
}

/// visible, falling smoothly to 0 within `taper` of the vertices that are not; `distance` is that from them.
Vector tapered(const Vector& visible, const Vector& distance, double taper) {
    Vector out(visible.size());
    for (Eigen::Index v = 0; v < visible.size(); ++v) {
        const double t = taper > 0 ? std::min(distance[v] / taper, 1.0) : (visible[v] < 0.5 ? 0.0 : 1.0);
        out[v] = visible[v] * t * t * (3 - 2 * t);
    }
    return out;
}

/// The vertices whose displacement is asked for: all but skin that is seen as a whole and lies farther than `margin` from
/// what is hidden; empty where that leaves out little.
std::vector<int> unsettled(const Vector& skin, const Vector& distance, double margin) {
    std::vector<int> free;
    for (Eigen::Index v = 0; v < skin.size(); ++v)
        if (skin[v] < 1 || distance[v] <= margin) free.push_back(static_cast<int>(v));
    if (2 * static_cast<Eigen::Index>(free.size()) > skin.size()) free.clear();
    return free;
}

void check_inner_frame(const std::string& name, const InnerFrame& f, const BodyModel& m) {
    const Eigen::Index n = m.v_template.rows();
    require(f.rotations.rows() == m.joints(), "inner: " + name + ".rotations has " +
                                                  std::to_string(f.rotations.rows()) + " rows, the model " +
                                                  std::to_string(m.joints()) + " joints");
    require(f.tracked.rows() == n && f.visible.size() == n,
            "inner: " + name + ".tracked and .visible have " + std::to_string(f.tracked.rows()) + " and " +
                std::to_string(f.visible.size()) + " rows, the model " + std::to_string(n) + " vertices");
    check_finite("inner", name + ".rotations", f.rotations);
    check_points("inner", name + ".translation", f.translation);
    check_points("inner", name + ".tracked", f.tracked);
    for (Eigen::Index v = 0; v < n; ++v)
        if (!(f.visible[v] >= 0 && f.visible[v] <= 1))
            throw InputError("inner: " + name + ".visible[" + std::to_string(v) + "] must lie in [0, 1]");
    for (std::size_t g = 0; g < f.garments.size(); ++g)
        check_mesh("inner", f.garments[g].V, f.garments[g].F, name + ".garments[" + std::to_string(g) + "].V",
                   name + ".garments[" + std::to_string(g) + "].F");
}

void count_outside(const Vector& room, const Vector& skin, double& depth, std::int64_t& count) {
    for (Eigen::Index v = 0; v < room.size(); ++v)
        if (skin[v] < 0.5 && room[v] < 0) {
            depth = std::max(depth, -room[v]);
            ++count;
        }
}

}  // namespace

InnerSolver::InnerSolver(BodyModel model, Vector shape, Vertices J, InnerOptions options)
    : model_(std::move(model)), shape_(std::move(shape)), J_(std::move(J)), options_(options) {
    check_body_model("inner", model_);
    check_finite("inner", "shape", shape_);
    require(shape_.size() <= model_.shapes(), "inner: shape has " + std::to_string(shape_.size()) +
                                                  " entries, the model " + std::to_string(model_.shapes()));
    require(J_.rows() == model_.joints(), "inner: J has " + std::to_string(J_.rows()) + " rows, the model " +
                                              std::to_string(model_.joints()) + " joints");
    check_points("inner", "J", J_);
    const InnerOptions& o = options_;
    for (double positive : {o.length, o.skin, o.out, o.prior, o.fit_scale, o.still, o.swing_error, o.reach,
                            o.shape_sigma, o.shape_observations, o.tolerance})
        require(
            positive > 0 && positive <= 1e50,
            "inner: length, skin, out, prior, fit_scale, still, swing_error, reach, tolerance and the shape's terms "
            "must be positive, up to 1e50");
    for (double other : {o.fit, o.swing, o.misfit, o.gap, o.taper})
        require(other >= 0 && other <= 1e50,
                "inner: fit, swing, misfit, gap and taper must not be negative, nor beyond 1e50");
    require(o.seldom >= 0 && o.seldom < o.often && o.often <= 1,
            "inner: seldom and often must be 0 <= seldom < often <= 1");
    require(o.tightness >= 0 && o.tightness <= 1, "inner: tightness must lie in [0, 1]");
    require(o.inward >= 0 && o.inward <= 1, "inner: inward must lie in [0, 1]");
    require(o.rounds > 0 && o.max_iterations > 0, "inner: rounds and max_iterations must be positive");
    shape_.conservativeResizeLike(Vector::Zero(model_.shapes()));
    rest_ = shaped_vertices(model_, shape_);
    mass_ = voronoi_mass(rest_, model_.F);
    smooth_ = smoothness_matrix(rest_, model_.F, mass_, o.length);
    analysis_.analyze(smooth_);
    neighbours_ = vertex_neighbours(model_.F, rest_.rows());
}

InnerSums InnerSolver::sums() const {
    const Eigen::Index n = rest_.rows();
    return {Vertices::Zero(n, 3), Vector::Zero(n), Vector::Zero(n), RoomCounts::Zero(n, kRoomNodes), 0};
}

void InnerSolver::gather(const InnerFrame& frame, const InnerGuess& guess, InnerSums& sums,
                         const std::string& name) const {
    const InnerOptions& o = options_;
    check_inner_frame(name, frame, model_);
    const Eigen::Index n = rest_.rows();
    check_inner_sums(sums, n);
    for (const Vertices* V : {&guess.rest, &guess.skin_mean})
        require(V->rows() == n || V->rows() == 0, "inner: guess has " + std::to_string(V->rows()) +
                                                      " rows, the model " + std::to_string(n) + " vertices");
    const Posed posed = pose_joints(model_.parents, J_, frame.rotations, frame.translation);
    const Vector skin = tapered(frame.visible, from_hidden(frame.visible, neighbours_, rest_, o.taper), o.taper);
    ++sums.frames;
    if (guess.asks_skin) {
        const Vertices rest = unskin_vertices(model_, frame.tracked, J_, posed);
        const double scale = o.shape_sigma * o.shape_sigma;
        parallel_for(n, [&](std::int64_t v) {
            const double q = guess.skin_mean.rows() ? (rest.row(v) - guess.skin_mean.row(v)).squaredNorm() / scale : 0;
            const double w = skin[v] / ((1 + q) * (1 + q));
            sums.position.row(v) += w * rest.row(v);
            sums.weight[v] += w;
            sums.skin[v] += skin[v];
        });
    }
    if (guess.rest.rows()) {
        const Vertices Y = skin_vertices(model_, guess.rest, J_, posed);
        const Vector room = cloth_room(Y, vertex_normals(Y, model_.F), skin, index_garments(frame.garments), o.reach);
        parallel_for(n, [&](std::int64_t v) {
            if (std::isfinite(room[v])) count_room(room[v], o.reach, sums.room.row(v).data());
        });
    }
}

InnerFused InnerSolver::fuse(const std::vector<InnerFrame>& frames) const {
    require(!frames.empty(), "inner: frames is empty");
    InnerFusion fusion(*this);
    while (!fusion.done()) {
        const InnerGuess guess = fusion.guess();
        InnerSums sums = this->sums();
        for (std::size_t f = 0; f < frames.size(); ++f)
            gather(frames[f], guess, sums, "frames[" + std::to_string(f) + "]");
        fusion.step(sums);
    }
    return fusion.fused();
}

InnerResult InnerSolver::solve(const Vertices& fused_rest, const InnerFrame& frame) const {
    require(fused_rest.rows() == rest_.rows(), "inner: fused_rest has " + std::to_string(fused_rest.rows()) +
                                                   " rows, the model " + std::to_string(rest_.rows()) + " vertices");
    check_points("inner", "fused_rest", fused_rest);
    check_inner_frame("frame", frame, model_);
    const InnerOptions& o = options_;
    const Vertices Y =
        skin_vertices(model_, fused_rest, J_, pose_joints(model_.parents, J_, frame.rotations, frame.translation));
    const Indexes garments = index_garments(frame.garments);
    InnerResult out;
    Evidence e;
    const double margin = o.taper + 6 * o.length / std::pow(o.skin, 0.25);  // six lengths over which skin lets go
    const Vector distance = from_hidden(frame.visible, neighbours_, rest_, margin);
    e.skin = tapered(frame.visible, distance, o.taper);
    e.skin_target = (frame.tracked - Y).array().colwise() * (e.skin.array() > 0).cast<double>();
    e.normals = vertex_normals(Y, model_.F);
    e.room = cloth_room(Y, e.normals, e.skin, garments, o.reach).array() - o.gap;
    count_outside(e.room.array() + o.gap, e.skin, out.depth_before, out.outside_before);
    e.room = e.room.cwiseMax(deepest(Y, model_.F, e.normals, e.skin, o.inward));
    e.likely = e.pull = Vector::Zero(Y.rows());  // the fused shape knows
    std::vector<int> free = unsettled(e.skin, distance, margin);
    Weighted system =
        free.empty() ? Weighted(smooth_, mass_, analysis_) : Weighted(smooth_, mass_, std::move(free), e.skin_target);
    const Fitted fitted = fit_displacement(system, mass_, e, o, Vertices::Zero(Y.rows(), 3));
    const auto g = e.skin.array();
    out.V = (frame.tracked.array().colwise() * g + (Y + fitted.d).array().colwise() * (1 - g)).matrix();
    count_outside(cloth_room(out.V, vertex_normals(out.V, model_.F), e.skin, garments, o.reach), e.skin,
                  out.depth_after, out.outside_after);
    out.skin = e.skin;
    out.stop = fitted.converged ? Stop::converged : Stop::max_iterations;
    out.iterations = static_cast<int>(fitted.energy.size());
    out.energy = fitted.energy;
    out.factorisations = system.factorisations();
    out.analyses = system.analyses();
    check_solved("inner", "V", out.V);
    check_solved("inner", "energy", Eigen::Map<const Vector>(out.energy.data(), out.iterations));
    return out;
}

}  // namespace toile
