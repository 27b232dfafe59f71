#include "geometry/path.h"

#include <algorithm>
#include <string>

#include "base/errors.h"

namespace toile {

Indices cheapest_path(const Matrix& cost, const Matrix& step) {
    const Eigen::Index k = cost.rows(), m = cost.cols();
    require(k > 0 && m > 0, "cheapest_path: cost is empty");
    require(step.rows() == m && step.cols() == m, "cheapest_path: step has " + std::to_string(step.rows()) + " x " +
                                                      std::to_string(step.cols()) + " entries, cost " +
                                                      std::to_string(m) + " columns");
    check_finite("cheapest_path", "cost", cost);
    check_finite("cheapest_path", "step", step);
    Eigen::Matrix<int, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> back(k, m);
    Eigen::RowVectorXd best = cost.row(0), total(m);
    for (Eigen::Index i = 1; i < k; ++i) {
        total = best[0] + step.row(0).array();
        back.row(i).setZero();
        for (int from = 1; from < m; ++from)
            for (Eigen::Index to = 0; to < m; ++to) {
                const double through = best[from] + step(from, to);
                back(i, to) = through < total[to] ? from : back(i, to);
                total[to] = std::min(through, total[to]);
            }
        best = total + cost.row(i);
    }
    Indices path(k);
    best.minCoeff(&path[k - 1]);
    for (Eigen::Index i = k - 1; i > 0; --i) path[i - 1] = back(i, path[i]);
    return path;
}

}  // namespace toile
