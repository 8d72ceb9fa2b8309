// A C++ program written for REP-155 and the headers of hri_msgs 0.9.0: nothing else of this stack.
//
// For test_rep155_cpp_client.py (built with CATKIN_ENABLE_TESTING), and to copy from. It does what rep155_client.py does and looks
// at more of what a face and a body have. One line of JSON for each thing learnt:
//   {"person": id, "face": id, "box": [xmin, ymin, xmax, ymax]}, {"person": id, "engagement": level}
//   {"face": id, "points": known, "of": all, "nose": [x, y], "size": [width, height]}, {"face": id, "units": {number: intensity}}
//   {"face": id, "expression": word, "valence": v, "arousal": a}, {"face": id, "age": years, "gender": constant}
//   {"body": id, "points": known, "of": all, "neck": [x, y]}, {"body": id, "posture": constant}, {"body": id, "gesture": constant}
//   {"voice": id, "said": text, "final": bool}, {"gaze": [sender, receiver]}, {"group": id, "members": [ids]}
//   {"space": name, "ids": [ids]}

#include <hri_msgs/BodyPosture.h>
#include <hri_msgs/EngagementLevel.h>
#include <hri_msgs/Expression.h>
#include <hri_msgs/FacialActionUnits.h>
#include <hri_msgs/FacialLandmarks.h>
#include <hri_msgs/Gaze.h>
#include <hri_msgs/Gesture.h>
#include <hri_msgs/Group.h>
#include <hri_msgs/IdsList.h>
#include <hri_msgs/LiveSpeech.h>
#include <hri_msgs/NormalizedPointOfInterest2D.h>
#include <hri_msgs/NormalizedRegionOfInterest2D.h>
#include <hri_msgs/Skeleton2D.h>
#include <hri_msgs/SoftBiometrics.h>
#include <ros/ros.h>
#include <std_msgs/String.h>

#include <functional>
#include <iostream>
#include <map>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace
{
constexpr uint32_t QUEUE = 10;

/// Text as JSON writes it.
std::string json(const std::string& text)
{
  std::ostringstream out;
  out << '"';
  for (const char letter : text)
  {
    if (letter == '"' || letter == '\\')
      out << '\\' << letter;
    else if (static_cast<unsigned char>(letter) < 0x20)
      out << ' ';
    else
      out << letter;
  }
  out << '"';
  return out.str();
}

std::string json(const std::vector<std::string>& texts)
{
  std::ostringstream out;
  for (std::size_t i = 0; i < texts.size(); ++i)
    out << (i ? ", " : "") << json(texts[i]);
  return "[" + out.str() + "]";
}

/// Prints one line; `fields` are key, value, key, value ... with values that are JSON already.
void tell(const std::vector<std::string>& fields)
{
  std::ostringstream out;
  for (std::size_t i = 0; i + 1 < fields.size(); i += 2)
    out << (i ? ", " : "") << json(fields[i]) << ": " << fields[i + 1];
  std::cout << "{" << out.str() << "}" << std::endl;
}

template <class... Numbers>
std::string array(const Numbers... numbers)
{
  std::ostringstream out;
  const std::vector<double> all{ static_cast<double>(numbers)... };
  for (std::size_t i = 0; i < all.size(); ++i)
    out << (i ? ", " : "") << all[i];
  return "[" + out.str() + "]";
}

std::string number(const double value)
{
  return std::to_string(value);
}

/// A vector, as the released headers have it: with arrays of a fixed length this does not compile.
std::string count_known(const std::vector<hri_msgs::NormalizedPointOfInterest2D>& points)
{
  std::size_t known = 0;
  for (const auto& point : points)
    known += point.c > 0.0F;
  return std::to_string(known);
}

template <class Message>
using Callback = std::function<void(const Message&)>;

template <class Message>
ros::Subscriber listen(ros::NodeHandle& node, const std::string& topic, Callback<Message> call)
{
  const boost::function<void(const boost::shared_ptr<const Message>&)> wrapped =
      [call](const boost::shared_ptr<const Message>& message) { call(*message); };
  return node.subscribe<Message>(topic, QUEUE, wrapped);
}

/// The ids of a tracked list, and what is subscribed to for each.
class Followed
{
public:
  using Subscribers = std::vector<ros::Subscriber>;

  Followed(ros::NodeHandle& node, const std::string& kind, std::function<Subscribers(const std::string&, const std::string&)> follow)
    : prefix_("/humans/" + kind + "/"), follow_(std::move(follow))
  {
    list_ = listen<hri_msgs::IdsList>(node, prefix_ + "tracked", [this](const hri_msgs::IdsList& message) { take(message.ids); });
  }

private:
  void take(const std::vector<std::string>& ids)
  {
    const std::set<std::string> there(ids.begin(), ids.end());
    for (auto one = subscribers_.begin(); one != subscribers_.end();)
      one = there.count(one->first) ? std::next(one) : subscribers_.erase(one);
    for (const auto& id : there)
      if (!subscribers_.count(id))
        subscribers_[id] = follow_(id, prefix_ + id + "/");
  }

  std::string prefix_;
  std::function<Subscribers(const std::string&, const std::string&)> follow_;
  std::map<std::string, Subscribers> subscribers_;
  ros::Subscriber list_;
};

/// Persons, faces, bodies, voices, gazes, groups and distances.
class Client
{
public:
  Client()
    : persons_(node_, "persons", [this](const std::string& id, const std::string& prefix) { return person(id, prefix); })
    , faces_(node_, "faces", [this](const std::string& id, const std::string& prefix) { return face(id, prefix); })
    , bodies_(node_, "bodies", [this](const std::string& id, const std::string& prefix) { return body(id, prefix); })
    , voices_(node_, "voices", [this](const std::string& id, const std::string& prefix) { return voice(id, prefix); })
  {
    others_.push_back(listen<hri_msgs::Gaze>(node_, "/humans/interactions/gazing", [](const hri_msgs::Gaze& message) {
      tell({ "gaze", json(std::vector<std::string>{ message.sender, message.receiver }) });
    }));
    others_.push_back(listen<hri_msgs::Group>(node_, "/humans/interactions/groups", [](const hri_msgs::Group& message) {
      tell({ "group", json(message.group_id), "members", json(message.members) });
    }));
    for (const std::string name : { "personal", "social", "public" })
      others_.push_back(listen<hri_msgs::IdsList>(node_, "/humans/persons/in_" + name + "_space", [name](const hri_msgs::IdsList& message) {
        tell({ "space", json(name), "ids", json(message.ids) });
      }));
  }

private:
  Followed::Subscribers person(const std::string& id, const std::string& prefix)
  {
    return { listen<std_msgs::String>(node_, prefix + "face_id",
                                      [this, id](const std_msgs::String& message) {
                                        if (!message.data.empty())
                                          owners_[message.data] = id;
                                      }),
             listen<hri_msgs::EngagementLevel>(node_, prefix + "engagement_status", [id](const hri_msgs::EngagementLevel& message) {
               tell({ "person", json(id), "engagement", std::to_string(message.level) });
             }) };
  }

  Followed::Subscribers face(const std::string& id, const std::string& prefix)
  {
    using hri_msgs::FacialLandmarks;
    return { listen<hri_msgs::NormalizedRegionOfInterest2D>(
                 node_, prefix + "roi",
                 [this, id](const hri_msgs::NormalizedRegionOfInterest2D& message) {
                   const auto owner = owners_.find(id);
                   if (owner != owners_.end())
                     tell({ "person", json(owner->second), "face", json(id), "box",
                            array(message.xmin, message.ymin, message.xmax, message.ymax) });
                 }),
             listen<FacialLandmarks>(node_, prefix + "landmarks",
                                     [id](const FacialLandmarks& message) {
                                       if (message.landmarks.size() <= FacialLandmarks::NOSE)
                                         return;
                                       const auto& nose = message.landmarks[FacialLandmarks::NOSE];
                                       tell({ "face", json(id), "points", count_known(message.landmarks), "of",
                                              std::to_string(message.landmarks.size()), "nose", array(nose.x, nose.y), "size",
                                              array(message.width, message.height) });
                                     }),
             listen<hri_msgs::FacialActionUnits>(node_, prefix + "facs",
                                                 [id](const hri_msgs::FacialActionUnits& message) { tell({ "face", json(id), "units", units(message) }); }),
             listen<hri_msgs::Expression>(node_, prefix + "expression",
                                          [id](const hri_msgs::Expression& message) {
                                            tell({ "face", json(id), "expression", json(message.expression), "valence",
                                                   number(message.valence), "arousal", number(message.arousal) });
                                          }),
             listen<hri_msgs::SoftBiometrics>(node_, prefix + "softbiometrics", [id](const hri_msgs::SoftBiometrics& message) {
               tell({ "face", json(id), "age", std::to_string(message.age), "gender", std::to_string(message.gender) });
             }) };
  }

  Followed::Subscribers body(const std::string& id, const std::string& prefix)
  {
    using hri_msgs::Skeleton2D;
    return { listen<Skeleton2D>(node_, prefix + "skeleton2d",
                                [id](const Skeleton2D& message) {
                                  if (message.skeleton.size() <= Skeleton2D::NECK)
                                    return;
                                  const auto& neck = message.skeleton[Skeleton2D::NECK];
                                  tell({ "body", json(id), "points", count_known(message.skeleton), "of",
                                         std::to_string(message.skeleton.size()), "neck", array(neck.x, neck.y) });
                                }),
             listen<hri_msgs::BodyPosture>(node_, prefix + "posture",
                                           [id](const hri_msgs::BodyPosture& message) {
                                             tell({ "body", json(id), "posture", std::to_string(message.posture) });
                                           }),
             listen<hri_msgs::Gesture>(node_, prefix + "gesture", [id](const hri_msgs::Gesture& message) {
               tell({ "body", json(id), "gesture", std::to_string(message.gesture) });
             }) };
  }

  Followed::Subscribers voice(const std::string& id, const std::string& prefix)
  {
    return { listen<hri_msgs::LiveSpeech>(node_, prefix + "speech", [id](const hri_msgs::LiveSpeech& message) {
      tell({ "voice", json(id), "said", json(message.final.empty() ? message.incremental : message.final), "final",
             message.final.empty() ? "false" : "true" });
    }) };
  }

  static std::string units(const hri_msgs::FacialActionUnits& message)
  {
    std::ostringstream out;
    for (std::size_t unit = 0; unit < message.intensity.size(); ++unit)
      if (message.confidence[unit] > 0.0F)
        out << (out.tellp() > 0 ? ", " : "") << '"' << unit << "\": " << message.intensity[unit];
    return "{" + out.str() + "}";
  }

  ros::NodeHandle node_;
  std::map<std::string, std::string> owners_;
  std::vector<ros::Subscriber> others_;
  Followed persons_, faces_, bodies_, voices_;
};
}  // namespace

int main(int argc, char** argv)
{
  ros::init(argc, argv, "rep155_cpp_client", ros::init_options::AnonymousName);
  const Client client;
  ros::spin();
  return 0;
}
