#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "base/errors.h"
#include "base/parallel.h"
#include "base/turns.h"
#include "geometry/laplacian.h"
#include "kernels/inner/displacement.h"
#include "kernels/inner/rooms.h"

namespace toile {

namespace {

constexpr int kSkinPasses = 3;  // the mean of all skin, then twice that of the skin near it

/// How sure (n,) in [0,1] each vertex is skin: where few of the frames showed it, it was a wrong label, which would
/// draw the body to the cloth.
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

/// Root mean square of seen skin off the model, along the normals [m].
double misfit(const Evidence& e, const Vector& mass) {
    const Vector off = e.skin_target.cwiseProduct(e.normals).rowwise().sum();
    const Vector weight = mass.cwiseProduct(e.skin);
    return std::sqrt(weight.dot(off.cwiseAbs2()) / std::max(weight.sum(), 1e-12));
}

/// Fills in where the body likely is and how strongly it is drawn there. Cloth that lies on the body keeps its room,
/// cloth that hangs off it swings, the more the farther off: the body is a few standard deviations of the room inside
/// of the mean. A vertex of few frames takes part in the swing of all. The sums must be those of d = 0: asked anew at a
/// body drawn inwards, armpits and folds would draw it on.
void place_by_swing(const InnerSums& sums, const Vector& mass, double misfit, const InnerOptions& o, Evidence& e) {
    const Eigen::Index n = mass.size();
    std::vector<RoomSpread> spread(static_cast<std::size_t>(n));
    parallel_for(n, [&](std::int64_t v) {
        spread[static_cast<std::size_t>(v)] = room_spread(sums.room.row(v).data(), o.reach);
    });
    double squares = 0, degrees = 0;
    for (Eigen::Index v = 0; v < n; ++v) {
        const RoomSpread& r = spread[static_cast<std::size_t>(v)];
        squares += mass[v] * (1 - e.skin[v]) * r.squares;
        degrees += mass[v] * (1 - e.skin[v]) * std::max(r.frames - 1, 0.0);
    }
    constexpr double kLeast = 1e-6;  // [m] keeps the ratio below where nothing moves
    constexpr double kShared = 0.1;  // frames that the swing of all counts as in a vertex's own
    const double mean_swing = std::hypot(degrees > 0 ? std::sqrt(squares / degrees) : 0, kLeast);
    const double trust = std::max(misfit * misfit - o.misfit * o.misfit, 0.0);
    e.likely = e.pull = Vector::Zero(n);
    parallel_for(n, [&](std::int64_t v) {
        const RoomSpread& r = spread[static_cast<std::size_t>(v)];
        if (r.frames <= 0) return;
        const double own = std::sqrt((r.squares + kShared * mean_swing * mean_swing) / (r.frames + kShared));
        const double swing = own * std::max(o.still / mean_swing, 1.0), error = o.swing_error + swing;
        e.likely[v] = r.mean - o.gap - o.swing * swing;
        e.pull[v] = o.fit * trust / (error * error);
    });
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

}  // namespace

struct InnerFusion::State {
    explicit State(const InnerSolver& s) : system(s.smooth_, s.mass_, s.analysis_), rounds(s.options_.rounds) {}
    bool done() const;

    Weighted system;
    int rounds;
    Evidence seen;
    Vertices model;  // of the refitted shape
    Vector deepest;  // how far along the normals its vertices may go inwards
    Fitted fitted;
    InnerFused fused;
    int passes = 0;
    Calls calls;
};

InnerFusion::InnerFusion(const InnerSolver& solver) : solver_(solver), state_(std::make_unique<State>(solver)) {
    guess_ = {solver.rest_, Vertices(0, 3), true};
    state_->seen.normals = vertex_normals(solver.rest_, solver.model_.F);
}

InnerFusion::~InnerFusion() = default;

bool InnerFusion::State::done() const { return passes == kSkinPasses + rounds; }

bool InnerFusion::done() const {
    const Calls::Reading together(state_->calls, "inner");
    return state_->done();
}

InnerGuess InnerFusion::guess() const {
    const Calls::Reading together(state_->calls, "inner");
    return guess_;
}

InnerFused InnerFusion::fused() const {
    const Calls::Reading together(state_->calls, "inner");
    require(state_->done(), "inner: the fusion waits for the sums of another pass");
    return state_->fused;
}

void InnerFusion::step(const InnerSums& sums) {
    const Calls::Writing alone(state_->calls, "inner");
    require(!state_->done(), "inner: the fusion is done");
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
    s.deepest = deepest(s.model, k.model_.F, vertex_normals(s.model, k.model_.F), s.seen.skin, k.options_.inward);
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
    const Vector along = e.normals.cwiseProduct(s.fitted.d).rowwise().sum();
    if (s.passes == kSkinPasses + 1) {
        place_by_swing(sums, k.mass_, misfit(e, k.mass_), k.options_, e);
        e.likely = e.likely.cwiseMax(s.deepest);
    }
    e.room = (tightest_room(sums, e.skin, k.options_) + along).cwiseMax(s.deepest);
    s.fitted = fit_displacement(s.system, k.mass_, e, k.options_, s.fitted.d);
    out.energy.insert(out.energy.end(), s.fitted.energy.begin(), s.fitted.energy.end());
    out.rest = guess_.rest = s.model + s.fitted.d;
    if (!s.done()) return;
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

}  // namespace toile
