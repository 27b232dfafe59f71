#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <string>

#include "base/errors.h"
#include "kernels/sight.h"

namespace toile {

namespace {

/// Weights of a Gaussian 0, 1, ... pixels off, cut at four sigmas; with their mirror images they sum to 1.
std::vector<float> gaussian(double sigma) {
    require(std::isfinite(sigma) && sigma > 0 && sigma < 1000,
            "soft_labels: blur is " + std::to_string(sigma) + ", expected pixels between 0 and 1000");
    const auto reach = static_cast<int>(std::lround(4 * sigma));
    std::vector<double> weight;
    double sum = 0;
    for (int k = 0; k <= reach; ++k) {
        weight.push_back(std::exp(-k * k / (2 * sigma * sigma)));
        sum += k == 0 ? weight[k] : 2 * weight[k];
    }
    std::vector<float> out;
    for (double w : weight) out.push_back(static_cast<float>(w / sum));
    return out;
}

/// The pixel of n that stands for place i beyond them: mirrored about the outermost ones' centres.
std::int64_t mirrored(std::int64_t i, std::int64_t n) {
    if (n == 1) return 0;
    const std::int64_t there = std::abs(i) % (2 * (n - 1));
    return std::min(there, 2 * (n - 1) - there);
}

/// Blurs the indicators of columns 0 .. L-1 along a row; a run of equal labels adds a difference of summed weights.
void blur_row(const std::uint8_t* column, std::int64_t w, int L, const std::vector<double>& summed, float* out) {
    const auto window = static_cast<std::int64_t>(summed.size()) - 1, reach = window / 2;
    std::vector<std::uint8_t> row(static_cast<std::size_t>(w + 2 * reach));
    std::vector<std::int64_t> end(row.size());
    for (std::int64_t i = 0; i < w + 2 * reach; ++i) row[i] = column[mirrored(i - reach, w)];
    for (auto i = static_cast<std::int64_t>(row.size()) - 1, stop = i + 1; i >= 0; --i) {
        if (i + 1 < stop && row[i] != row[i + 1]) stop = i + 1;
        end[i] = stop;
    }
    std::fill(out, out + w * L, 0.0f);
    for (std::int64_t x = 0; x < w; ++x)
        for (std::int64_t i = x; i < x + window;) {
            const std::int64_t next = std::min(end[i], x + window);
            if (row[i] < L) out[x * L + row[i]] += static_cast<float>(summed[next - x] - summed[i - x]);
            i = next;
        }
}

/// Blurred indicators (h, w, L) of columns 0 .. L-1; any other value belongs to none.
std::vector<float> blurred(const std::vector<std::uint8_t>& column, std::int64_t h, std::int64_t w, int L,
                           double sigma) {
    const std::vector<float> weight = gaussian(sigma);
    const auto reach = static_cast<std::int64_t>(weight.size()) - 1;
    std::vector<double> summed(1, 0.0);
    for (std::int64_t k = -reach; k <= reach; ++k) summed.push_back(summed.back() + weight[std::abs(k)]);
    const std::int64_t n = w * L;
    std::vector<float> across(static_cast<std::size_t>(h * n)), out(across.size());
    for (std::int64_t y = 0; y < h; ++y) blur_row(&column[y * w], w, L, summed, &across[y * n]);
    for (std::int64_t y = 0; y < h; ++y) {
        float* to = &out[y * n];
        const float* own = &across[y * n];
        for (std::int64_t i = 0; i < n; ++i) to[i] = weight[0] * own[i];
        for (std::int64_t k = 1; k <= reach; ++k) {
            const float *above = &across[mirrored(y - k, h) * n], *below = &across[mirrored(y + k, h) * n];
            for (std::int64_t i = 0; i < n; ++i) to[i] += weight[k] * (above[i] + below[i]);
        }
    }
    return out;
}

/// Each pixel's place among `ids`, or their number.
std::vector<std::uint8_t> columns_of(const LabelImage& image, const std::vector<std::uint8_t>& ids) {
    require(!ids.empty() && ids.size() < 255, "soft_labels: ids has " + std::to_string(ids.size()) + " entries");
    std::vector<std::uint8_t> table(256, static_cast<std::uint8_t>(ids.size())), out;
    for (std::size_t i = 0; i < ids.size(); ++i) table[ids[i]] = static_cast<std::uint8_t>(i);
    out.reserve(static_cast<std::size_t>(image.height * image.width));
    for (std::int64_t i = 0; i < image.height * image.width; ++i) out.push_back(table[image.values[i]]);
    return out;
}

}  // namespace

std::vector<float> soft_labels(const LabelImage& image, const std::vector<std::uint8_t>& ids, double blur) {
    return blurred(columns_of(image, ids), image.height, image.width, static_cast<int>(ids.size()), blur);
}

std::vector<float> evidence_picture(const LabelImage& image, const std::vector<std::uint8_t>& ids, const bool* clear,
                                    const float* likelihood, const std::uint8_t* rgb, double blur, double empty_blur) {
    const std::vector<float> soft = soft_labels(image, ids, blur), empty = soft_labels(image, {0}, empty_blur);
    const auto L = static_cast<std::int64_t>(ids.size()), channels = 2 * L + 4, n = image.height * image.width;
    std::array<float, 256> share;
    for (std::size_t value = 0; value < share.size(); ++value) share[value] = static_cast<float>(value) / 255;
    std::vector<float> out(static_cast<std::size_t>(n * channels));
    for (std::int64_t i = 0; i < n; ++i) {
        float* to = &out[i * channels];
        if (likelihood && clear[i]) {
            for (std::int64_t l = 0; l < L; ++l) to[l] = likelihood[l];
            likelihood += L;
        }
        for (std::int64_t l = 0; l < L; ++l) to[L + l] = soft[i * L + l];
        for (int c = 0; rgb && c < 3; ++c) to[2 * L + c] = share[rgb[3 * i + c]];
        to[channels - 1] = empty[i];
    }
    return out;
}

}  // namespace toile
