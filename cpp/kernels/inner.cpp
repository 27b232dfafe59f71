#include "kernels/inner.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <queue>

#include "base/errors.h"
#include "base/parallel.h"
#include "base/sparse.h"
#include "geometry/closest.h"
#include "geometry/laplacian.h"
#include "geometry/topology.h"

namespace toile {

namespace {

constexpr double kNone = std::numeric_limits<double>::infinity();

/// One scalar matrix smooth + diag(m w), refactored only when its weights change.
class Weighted {
public:
    /// `analysis` is that of `smooth`.
    Weighted(const Sparse& smooth, const Vector& mass, const CholeskyFactor& analysis)
        : smooth_(smooth), mass_(mass), factor_(analysis.symbolic()) {}

    Vertices solve(const Vector& weights, const Vertices& targets) {
        if (weights.size() != last_.size() || weights != last_) {
            Sparse A = smooth_;
            for (int c = 0; c < A.outerSize(); ++c)
                for (Sparse::InnerIterator it(A, c); it; ++it)
                    if (it.row() == it.col()) it.valueRef() += mass_[c] * weights[c];
            factor_.factorize(A);
            last_ = weights;
        }
        return factor_.solve((mass_.asDiagonal() * targets).eval());
    }
    std::int64_t factorisations() const { return factor_.factorisations(); }
    std::int64_t analyses() const { return factor_.analyses(); }
    double smoothness(const Vertices& d) const { return (d.transpose() * (smooth_ * d)).trace(); }

private:
    const Sparse& smooth_;
    const Vector& mass_;
    CholeskyFactor factor_;
    Vector last_;
};

/// What one linear solve knows of each vertex.
struct Evidence {
    Vertices skin_target;  // (n,3) displacement where skin was seen
    Vector skin;           // (n,) in [0,1]
    Vertices normals;      // (n,3)
    Vector room;           // (n,) along the normal to the cloth less the gap, at d = 0; infinity: none
};

struct Fitted {
    Vertices d;
    std::vector<double> energy;
    bool converged = false;
};

/// Reweighted least squares of E(d); `fit` is 0 for a frame, whose body already follows the fused shape.
Fitted fit_displacement(Weighted& system, const Vector& mass, const Evidence& e, const InnerOptions& o, double fit,
                        Vertices d) {
    Fitted result;
    const Eigen::Index n = mass.size();
    Vector weights(n);
    Vertices targets(n, 3);
    for (int i = 0; i < o.max_iterations; ++i) {
        double energy = system.smoothness(d);
        for (Eigen::Index v = 0; v < n; ++v) {
            const Vec3 dv = d.row(v), n_v = e.normals.row(v);
            const Vec3 skin_miss = dv - Vec3(e.skin_target.row(v));
            weights[v] = o.prior + o.skin * e.skin[v];
            targets.row(v) = o.skin * e.skin[v] * e.skin_target.row(v);
            double cost = o.prior * dv.squaredNorm() + o.skin * e.skin[v] * skin_miss.squaredNorm();
            if (const double slack = e.room[v] - n_v.dot(dv); std::isfinite(slack)) {
                const double q = slack * slack / (o.fit_scale * o.fit_scale), hidden = 1 - e.skin[v];
                const double w = hidden * (slack < 0 ? o.out : fit / ((1 + q) * (1 + q)));
                cost += hidden * (slack < 0 ? o.out * slack * slack : fit * slack * slack / (1 + q));
                weights[v] += w;
                targets.row(v) += (w * (dv + slack * n_v)).transpose();  // moves along the normal, stays put across it
            }
            energy += mass[v] * cost;
        }
        result.energy.push_back(energy);
        const Vertices next = system.solve(weights, targets);
        const double moved = (next - d).rowwise().norm().maxCoeff();
        d = next;
        if (moved < o.tolerance) {
            result.converged = true;
            break;
        }
    }
    result.d = d;
    return result;
}

using Indexes = std::vector<SurfaceIndex>;

Indexes index_garments(const std::vector<InnerGarment>& garments) {
    Indexes out;
    for (const InnerGarment& g : garments) out.emplace_back(g.V, g.F);
    return out;
}

/// Per vertex, how far along its normal the nearest cloth lies (negative: the vertex is outside it); infinity where
/// none is in reach, or where the nearest lies beside the vertex, beyond a hem. The innermost garment counts.
Vector cloth_room(const Vertices& Y, const Vertices& normals, const Vector& skin, const Indexes& garments,
                  double reach) {
    Vector room = Vector::Constant(Y.rows(), kNone);
    parallel_for(Y.rows(), [&](std::int64_t v) {
        if (skin[v] >= 1) return;
        for (const SurfaceIndex& garment : garments) {
            const SurfacePoint hit = garment.closest(Vec3(Y.row(v)), reach);
            if (hit.face < 0) continue;
            const Vec3 gap = hit.point - Y.row(v).transpose();
            const double along = gap.dot(Vec3(normals.row(v)));
            if (hit.distance < 1e-3 || std::abs(along) > 0.7 * hit.distance) room[v] = std::min(room[v], along);
        }
    });
    return room;
}

constexpr int kRoomNodes = 513;    // from -reach to reach
constexpr double kRoomUnit = 256;  // counts of one frame

/// Counts a frame's room at the two nodes beside it, by nearness: the quantile stays continuous in the room, and whole
/// numbers add up to the same bits in any order.
void count_room(double room, double reach, std::uint32_t* nodes) {
    const double at = std::clamp((room / reach + 1) * (kRoomNodes - 1) / 2, 0.0, kRoomNodes - 1.0);
    const int low = std::min(static_cast<int>(at), kRoomNodes - 2);
    const auto beyond = static_cast<std::uint32_t>(std::lround((at - low) * kRoomUnit));
    nodes[low] += static_cast<std::uint32_t>(kRoomUnit) - beyond;
    nodes[low + 1] += beyond;
}

/// The q-quantile of counted rooms, linear between the ranks of the nodes' middles, to within a node; infinity without any.
double room_quantile(const std::uint32_t* nodes, double reach, double q) {
    double total = 0;
    for (int j = 0; j < kRoomNodes; ++j) total += nodes[j];
    if (total <= 0) return kNone;
    const double rank = q * (total - kRoomUnit) + kRoomUnit / 2;
    double before = 0, last_rank = 0, last = kNone;
    for (int j = 0; j < kRoomNodes; ++j) {
        if (nodes[j] == 0) continue;
        const double here = reach * (2.0 * j / (kRoomNodes - 1) - 1), middle = before + 0.5 * nodes[j];
        if (middle >= rank)
            return std::isfinite(last) ? last + (rank - last_rank) / (middle - last_rank) * (here - last) : here;
        before += nodes[j];
        last_rank = middle;
        last = here;
    }
    return last;
}

/// length^4 L M^-1 L, with masses below (length / 10)^2 raised to that: smaller cells bend as one, and the smallest
/// triangles of fingers and lids do not ruin the factor's condition.
Sparse smoothness_matrix(const Vertices& V, const Faces& F, const Vector& mass, double length) {
    const Sparse L = cotangent_laplacian(V, F);
    const Vector inverse = mass.cwiseMax(0.01 * length * length).cwiseInverse();
    Sparse Q = L.transpose() * inverse.asDiagonal() * L * std::pow(length, 4);
    Sparse diagonal(V.rows(), V.rows());  // isolated vertices keep a place on the diagonal
    diagonal.setIdentity();
    Q += 0 * diagonal;
    Q.makeCompressed();
    return Q;
}

/// visible, falling smoothly to 0 within `taper` of the vertices that are not, along the edges (Dijkstra).
Vector tapered(const Vector& visible, const Adjacency& neighbours, const Vertices& V, double taper) {
    const Eigen::Index n = visible.size();
    Vector distance = Vector::Constant(n, kNone);
    std::priority_queue<std::pair<double, int>, std::vector<std::pair<double, int>>, std::greater<>> queue;
    for (Eigen::Index v = 0; v < n; ++v)
        if (visible[v] < 0.5) {
            distance[v] = 0;
            queue.emplace(0.0, static_cast<int>(v));
        }
    while (!queue.empty()) {
        const auto [d, v] = queue.top();
        queue.pop();
        if (d > distance[v]) continue;
        for (int e = neighbours.start[static_cast<std::size_t>(v)];
             e < neighbours.start[static_cast<std::size_t>(v) + 1]; ++e) {
            const int w = neighbours.index[static_cast<std::size_t>(e)];
            const double next = d + (V.row(v) - V.row(w)).norm();
            if (next >= distance[w] || next > taper) continue;
            distance[w] = next;
            queue.emplace(next, w);
        }
    }
    Vector out(n);
    for (Eigen::Index v = 0; v < n; ++v) {
        const double t = taper > 0 ? std::min(distance[v] / taper, 1.0) : (visible[v] < 0.5 ? 0.0 : 1.0);
        out[v] = visible[v] * t * t * (3 - 2 * t);
    }
    return out;
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
        require(f.visible[v] >= 0 && f.visible[v] <= 1,
                "inner: " + name + ".visible[" + std::to_string(v) + "] must lie in [0, 1]");
    for (std::size_t g = 0; g < f.garments.size(); ++g)
        check_mesh("inner", f.garments[g].V, f.garments[g].F, name + ".garments[" + std::to_string(g) + "].V",
                   name + ".garments[" + std::to_string(g) + "].F");
}

void check_inner_sums(const InnerSums& sums, Eigen::Index n) {
    require(sums.position.rows() == n && sums.weight.size() == n && sums.skin.size() == n && sums.room.rows() == n &&
                sums.room.cols() == kRoomNodes,
            "inner: sums of another body model");
}

constexpr int kSkinPasses = 3;  // the mean of all skin, then twice that of the skin near it

/// How sure (n,) in [0,1] each vertex is skin: where few of the frames showed it, it was a wrong label, which would draw
/// the body to the cloth.
Vector seen_skin(const InnerSums& sums, const InnerOptions& o) {
    return sums.skin.unaryExpr([&](double seen) {
        const double share = seen / static_cast<double>(sums.frames);
        const double t = std::clamp((share - o.seldom) / (o.often - o.seldom), 0.0, 1.0);
        return std::min(seen, 1.0) * t * t * (3 - 2 * t);
    });
}

/// Mean rest position (n,3) of the skin; 0 where none was seen.
Vertices mean_skin(const InnerSums& sums) {
    return sums.position.array().colwise() / sums.weight.array().max(std::numeric_limits<double>::min());
}

/// Tightest room over the frames: the quantile of the vertex's room in the frames where it is hidden.
Vector tightest_room(const InnerSums& sums, const Vector& skin, const InnerOptions& o) {
    Vector room = Vector::Constant(skin.size(), kNone);
    parallel_for(skin.size(), [&](std::int64_t v) {
        if (skin[v] < 1) room[v] = room_quantile(sums.room.row(v).data(), o.reach, o.tightness) - o.gap;
    });
    return room;
}

/// Shape coefficients that fit the seen skin and leave no hidden vertex outside the cloth: ridge regression about the
/// prior N(0, 1), one-sided terms reweighted. `room` is measured at the rest shape of `start`.
Vector refit_shape(const BodyModel& m, const Vector& start, const Evidence& e, const Vertices& skin_rest,
                   const Vector& mass, const InnerOptions& o) {
    const int S = m.shapes();
    if (S == 0) return start;
    const Vertices base = shaped_vertices(m, start);
    const double scale = o.shape_observations / (o.shape_sigma * o.shape_sigma * std::max(mass.dot(e.skin), 1e-12));
    Eigen::MatrixXd H0 = Eigen::MatrixXd::Identity(S, S);
    Vector g0 = -start;
    for (Eigen::Index v = 0; v < mass.size(); ++v) {
        if (e.skin[v] <= 0) continue;
        const Eigen::Matrix<double, 3, Eigen::Dynamic> D = m.shapedirs.middleRows<3>(3 * v);
        const Vec3 miss = skin_rest.row(v) - base.row(v);
        H0.noalias() += scale * mass[v] * e.skin[v] * D.transpose() * D;
        g0.noalias() += scale * mass[v] * e.skin[v] * D.transpose() * miss;
    }
    Vector step = Vector::Zero(S);
    for (int i = 0; i < 8; ++i) {
        Eigen::MatrixXd H = H0;
        Vector g = g0;
        for (Eigen::Index v = 0; v < mass.size(); ++v) {
            if (!std::isfinite(e.room[v]) || e.skin[v] >= 1) continue;
            const Vector along = m.shapedirs.middleRows<3>(3 * v).transpose() * Vec3(e.normals.row(v));
            if (along.dot(step) <= e.room[v]) continue;
            const double w = scale * mass[v] * (1 - e.skin[v]);
            H.noalias() += w * along * along.transpose();
            g.noalias() += w * e.room[v] * along;
        }
        const Vector next = H.ldlt().solve(g);
        const double moved = (next - step).norm();
        step = next;
        if (moved < 1e-6) break;
    }
    return start + step;
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
    for (double positive :
         {o.length, o.skin, o.out, o.prior, o.fit_scale, o.reach, o.shape_sigma, o.shape_observations, o.tolerance})
        require(positive > 0 && positive <= 1e50,
                "inner: length, skin, out, prior, fit_scale, reach, tolerance and the shape's terms must be positive, "
                "up to 1e50");
    require(o.fit >= 0 && o.gap >= 0 && o.taper >= 0 && o.fit + o.gap + o.taper <= 1e50,
            "inner: fit, gap and taper must not be negative, nor beyond 1e50");
    require(o.seldom >= 0 && o.seldom < o.often && o.often <= 1,
            "inner: seldom and often must be 0 <= seldom < often <= 1");
    require(o.tightness >= 0 && o.tightness <= 1, "inner: tightness must lie in [0, 1]");
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

InnerSums& InnerSums::operator+=(const InnerSums& other) {
    check_inner_sums(*this, other.position.rows());
    check_inner_sums(other, position.rows());
    position += other.position;
    weight += other.weight;
    skin += other.skin;
    room += other.room;
    frames += other.frames;
    return *this;
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
    const Vector skin = tapered(frame.visible, neighbours_, rest_, o.taper);
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
        InnerSums sums = this->sums();
        for (std::size_t f = 0; f < frames.size(); ++f)
            gather(frames[f], fusion.guess(), sums, "frames[" + std::to_string(f) + "]");
        fusion.step(sums);
    }
    return fusion.fused();
}

struct InnerFusion::State {
    explicit State(const InnerSolver& s) : system(s.smooth_, s.mass_, s.analysis_) {}

    Weighted system;
    Evidence seen;
    Vertices model;  // of the refitted shape
    Fitted fitted;
    InnerFused fused;
    int passes = 0;
};

InnerFusion::InnerFusion(const InnerSolver& solver) : solver_(solver), state_(std::make_unique<State>(solver)) {
    guess_ = {solver.rest_, Vertices(0, 3), true};
    state_->seen.normals = vertex_normals(solver.rest_, solver.model_.F);
}

InnerFusion::~InnerFusion() = default;

bool InnerFusion::done() const { return state_->passes == kSkinPasses + solver_.options_.rounds; }

const InnerFused& InnerFusion::fused() const {
    require(done(), "inner: the fusion waits for the sums of another pass");
    return state_->fused;
}

void InnerFusion::step(const InnerSums& sums) {
    require(!done(), "inner: the fusion is done");
    require(sums.frames > 0, "inner: frames is empty");
    check_inner_sums(sums, solver_.rest_.rows());
    ++state_->passes;
    if (state_->passes <= kSkinPasses)
        average(sums);
    else
        fit(sums);
}

void InnerFusion::average(const InnerSums& sums) {
    State& s = *state_;
    const InnerSolver& k = solver_;
    if (s.passes == 1) {
        s.seen.skin = seen_skin(sums, k.options_);
        s.seen.room = tightest_room(sums, s.seen.skin, k.options_);
    }
    guess_ = {Vertices(0, 3), mean_skin(sums), true};
    if (s.passes < kSkinPasses) return;
    s.fused.shape = refit_shape(k.model_, k.shape_, s.seen, guess_.skin_mean, k.mass_, k.options_);
    s.model = shaped_vertices(k.model_, s.fused.shape);
    s.seen.skin_target = (guess_.skin_mean - s.model).array().colwise() * (s.seen.skin.array() > 0).cast<double>();
    s.fitted.d = Vertices::Zero(s.model.rows(), 3);
    guess_ = {s.model, Vertices(0, 3), false};
}

void InnerFusion::fit(const InnerSums& sums) {
    State& s = *state_;
    const InnerSolver& k = solver_;
    Evidence& e = s.seen;
    InnerFused& out = s.fused;
    e.normals = vertex_normals(guess_.rest, k.model_.F);
    e.room = tightest_room(sums, e.skin, k.options_) + e.normals.cwiseProduct(s.fitted.d).rowwise().sum();
    s.fitted = fit_displacement(s.system, k.mass_, e, k.options_, k.options_.fit, s.fitted.d);
    out.energy.insert(out.energy.end(), s.fitted.energy.begin(), s.fitted.energy.end());
    out.rest = guess_.rest = s.model + s.fitted.d;
    if (!done()) return;
    out.bound = e.room - e.normals.cwiseProduct(s.fitted.d).rowwise().sum();
    out.stop = s.fitted.converged ? Stop::converged : Stop::max_iterations;
    out.iterations = static_cast<int>(out.energy.size());
    out.observed = (e.skin.array() > 0.5).count();
    out.bounded = (e.room.array() < kNone).count();
    out.factorisations = s.system.factorisations();
    out.analyses = s.system.analyses();
    check_solved("inner", "rest", out.rest);
    check_solved("inner", "energy", Eigen::Map<const Vector>(out.energy.data(), out.iterations));
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
    e.skin = tapered(frame.visible, neighbours_, rest_, o.taper);
    e.skin_target = (frame.tracked - Y).array().colwise() * (e.skin.array() > 0).cast<double>();
    e.normals = vertex_normals(Y, model_.F);
    e.room = cloth_room(Y, e.normals, e.skin, garments, o.reach).array() - o.gap;
    count_outside(e.room.array() + o.gap, e.skin, out.depth_before, out.outside_before);
    Weighted system(smooth_, mass_, analysis_);
    const Fitted fitted = fit_displacement(system, mass_, e, o, 0, Vertices::Zero(Y.rows(), 3));
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
