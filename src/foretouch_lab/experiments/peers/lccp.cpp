// SPDX-License-Identifier: Apache-2.0
// Split clusters of points by local convexity with PCL: pcl::LCCPSegmentation (Stein et al., Object Partitioning Using
// Local Convexity, CVPR 2014) on the supervoxels of each cluster alone.
//
// A library that peers/__init__.py compiles and calls.

#include <algorithm>
#include <cstdint>
#include <exception>
#include <map>
#include <vector>

#include <pcl/point_types.h>
#include <pcl/segmentation/lccp_segmentation.h>
#include <pcl/segmentation/supervoxel_clustering.h>

using Point = pcl::PointXYZRGBA;

struct Settings {
  float voxel, seed, concavity;
};

// Label the points of one cluster; labels from `next` on, which grows.
static void split(const pcl::PointCloud<Point>::Ptr &cloud, const Settings &settings,
                  const std::vector<std::size_t> &index, std::vector<std::int32_t> &labels, std::int32_t &next) {
  pcl::SupervoxelClustering<Point> supervoxels(settings.voxel, settings.seed);
  supervoxels.setUseSingleCameraTransform(false);
  supervoxels.setInputCloud(cloud);
  supervoxels.setColorImportance(0.0f);
  supervoxels.setSpatialImportance(1.0f);
  supervoxels.setNormalImportance(4.0f);
  std::map<std::uint32_t, pcl::Supervoxel<Point>::Ptr> clusters;
  supervoxels.extract(clusters);
  std::multimap<std::uint32_t, std::uint32_t> neighbours;
  supervoxels.getSupervoxelAdjacency(neighbours);

  pcl::LCCPSegmentation<Point> lccp;
  lccp.setConcavityToleranceThreshold(settings.concavity);
  lccp.setSanityCheck(true);
  lccp.setSmoothnessCheck(true, settings.voxel, settings.seed, 0.1f);
  lccp.setKFactor(0);
  lccp.setMinSegmentSize(5);
  lccp.setInputSupervoxels(clusters, neighbours);
  lccp.segment();
  const auto labelled = supervoxels.getLabeledCloud();
  lccp.relabelCloud(*labelled);

  std::map<std::uint32_t, std::int32_t> names;
  for (std::size_t k = 0; k < index.size(); ++k) {
    const std::uint32_t label = labelled->points[k].label;
    if (label == 0) continue;
    auto found = names.find(label);
    if (found == names.end()) found = names.emplace(label, next++).first;
    labels[index[k]] = found->second;
  }
  if (names.empty()) {  // too small for a supervoxel: one object, as it came
    for (const std::size_t k : index) labels[k] = next;
    ++next;
  }
}

// Label n points: `labels` gets 1 and up, 0 where a point has no supervoxel. Returns 0, or 1 after an error of PCL.
//
// xyz: (n, 3) points [m]; clusters: (n,) the cluster of each, 1 and up; settings: edge of a voxel [m], distance of seeds [m],
// concavity that is tolerated [deg].
extern "C" int lccp(std::int32_t n, const float *xyz, const std::int32_t *clusters, const float *settings,
                    std::int32_t *labels) try {
  std::vector<std::int32_t> found(n, 0);
  std::map<std::int32_t, std::vector<std::size_t>> members;
  for (std::int32_t k = 0; k < n; ++k) members[clusters[k]].push_back(k);
  std::int32_t next = 1;
  for (const auto &[name, index] : members) {
    pcl::PointCloud<Point>::Ptr cloud(new pcl::PointCloud<Point>);
    cloud->reserve(index.size());
    for (const std::size_t k : index) {
      Point point;
      point.x = xyz[3 * k], point.y = xyz[3 * k + 1], point.z = xyz[3 * k + 2], point.rgba = 0;
      cloud->push_back(point);
    }
    split(cloud, {settings[0], settings[1], settings[2]}, index, found, next);
  }
  std::copy(found.begin(), found.end(), labels);
  return 0;
} catch (const std::exception &) {
  return 1;
}
