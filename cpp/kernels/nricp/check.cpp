#include "kernels/nricp/check.h"

#include <algorithm>
#include <cmath>

#include "base/errors.h"
#include "geometry/confidence.h"

namespace toile {

using std::to_string;

void check_size(const char* name, const Vertices& V) {
    for (Eigen::Index i = 0; i < V.rows(); ++i)
        if (!(V.row(i).cwiseAbs().maxCoeff() <= largest_length))
            throw InputError(std::string("nricp: ") + name + "[" + to_string(i) + "] lies beyond 1e30");
}

void check_options(const NricpOptions& o) {
    const std::size_t levels = o.relative_radii.size();
    require(levels > 0, "nricp: relative_radii is empty");
    const auto fits = [&](const auto& values, const char* name) {
        require(values.size() == levels, std::string("nricp: ") + name + " has " + to_string(values.size()) +
                                             " entries, relative_radii has " + to_string(levels));
        for (std::size_t i = 0; i < values.size(); ++i)
            require(values[i] >= 0 && std::isfinite(values[i]),
                    std::string("nricp: ") + name + "[" + to_string(i) + "] is not a number >= 0");
    };
    const auto positive = [&](const std::vector<double>& values, const char* name) {
        fits(values, name);
        for (std::size_t i = 0; i < levels; ++i)
            require(values[i] > 0, std::string("nricp: ") + name + "[" + to_string(i) + "] is not positive");
    };
    const auto scale = [&](const std::vector<double>& values, const char* name) {
        positive(values, name);
        for (std::size_t i = 0; i < levels; ++i)
            require(values[i] >= 1e-12 && values[i] <= 1e12,
                    std::string("nricp: ") + name + "[" + to_string(i) + "] lies outside of 1e-12 to 1e12");
    };
    positive(o.relative_radii, "relative_radii");
    fits(o.iterations, "iterations");
    positive(o.stiffness_start, "stiffness_start");
    positive(o.stiffness_end, "stiffness_end");
    scale(o.relative_robust_start, "relative_robust_start");
    scale(o.relative_robust_end, "relative_robust_end");
    fits(o.reverse, "reverse");
    fits(o.relative_spread, "relative_spread");
    fits(o.relative_detail, "relative_detail");
    fits(o.settled, "settled");
    const std::pair<const char*, double> shares[]{{"phong", o.phong},
                                                  {"point_weight", o.point_weight},
                                                  {"boundary_weight", o.boundary_weight},
                                                  {"border_weight", o.border_weight},
                                                  {"rotation_weight", o.rotation_weight},
                                                  {"min_overlap", o.min_overlap},
                                                  {"exposure", o.exposure},
                                                  {"fine_noise", o.fine_noise}};
    for (const auto& [name, value] : shares)
        require(value >= 0 && std::isfinite(value), std::string("nricp: ") + name + " is not a number >= 0");
    require(o.passes > 0, "nricp: passes is not positive");
    require(o.relative_fine_robust >= 1e-12 && o.relative_fine_robust <= 1e12,
            "nricp: relative_fine_robust lies outside of 1e-12 to 1e12");
    require(o.relative_fine_length > 0 && o.relative_fine_length <= 1e12,
            "nricp: relative_fine_length is not in 0 to 1e12");
    require(o.fine_iterations >= 0 && o.fine_sweeps > 0, "nricp: fine_iterations or fine_sweeps is out of range");
}

void check_frame(const NricpFrame& f, Eigen::Index n, const NricpOptions& options) {
    check_mesh("nricp", f.V, f.F, "scan_V", "scan_F");
    check_size("scan_V", f.V);
    check_confidence("nricp", "scan_confidence", f.confidence, f.V.rows());
    if (f.start.rows() > 0) {
        require(f.start.rows() == n, "nricp: start has " + to_string(f.start.rows()) + " rows, V has " + to_string(n));
        check_points("nricp", "start", f.start);
    }
    const auto& [W, P, sigma] = f.landmarks;
    const Eigen::Index k = W.rows();
    if (k > 0)
        require(W.cols() == n,
                "nricp: landmarks W has " + to_string(W.cols()) + " columns, V has " + to_string(n) + " rows");
    require(P.rows() == k, "nricp: landmarks P has " + to_string(P.rows()) + " rows, W has " + to_string(k));
    if (k > 0) check_points("nricp", "landmarks P", P);
    require(k == 0 || sigma.size() == 1 || sigma.size() == k,
            "nricp: landmarks sigma has " + to_string(sigma.size()) + " entries, W has " + to_string(k) + " rows");
    for (Eigen::Index i = 0; i < sigma.size(); ++i)
        require(sigma[i] > 0 && std::isfinite(sigma[i]),
                "nricp: landmarks sigma[" + to_string(i) + "] is not positive");
    for (Eigen::Index i = 0; i < k; ++i) {
        double sum = 0, least = 0;
        for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator r(W, i); r; ++r) {
            require(r.col() >= 0 && r.col() < n,
                    "nricp: landmarks W[" + to_string(i) + "] holds vertex " + to_string(r.col()));
            sum += r.value();
            least = std::min(least, r.value());
        }
        require(std::abs(sum - 1) < 1e-6 && least >= 0,
                "nricp: landmarks W[" + to_string(i) + "] is not a convex combination (weights >= 0 with sum 1)");
    }
    for (std::size_t l = 0; l < f.loops.size(); ++l) {
        const std::string name = "boundary[" + to_string(l) + "]";
        check_indices("nricp", name + " vertices", f.loops[l].vertices, n);
        require(f.loops[l].polyline.rows() > 1, "nricp: " + name + " polyline has fewer than 2 points");
        check_points("nricp", name + " polyline", f.loops[l].polyline);
    }
    require(f.labels.size() == 0 || f.labels.size() == f.F.rows(),
            "nricp: scan_labels has " + to_string(f.labels.size()) + " entries, scan_F has " + to_string(f.F.rows()));
    require(f.labels.size() == 0 || !options.labels.empty(),
            "nricp: scan_labels given, but the option `labels` names no valid one");
}

}  // namespace toile
