/* Clients of an OpenIGTLink server: one built on Debian's OpenIGTLink library, and a plain connection for whatever the library cannot do. */
#ifndef TROCAR_TESTS_SLICER_CLIENT_H
#define TROCAR_TESTS_SLICER_CLIENT_H

#include <arpa/inet.h>
#include <cstring>
#include <map>
#include <string>
#include <sys/socket.h>
#include <unistd.h>
#include <vector>

#include <igtlClientSocket.h>
#include <igtlImageMessage.h>
#include <igtlMessageHeader.h>
#include <igtlPolyDataMessage.h>
#include <igtlStringMessage.h>
#include <igtlTransformMessage.h>

#include "expect.h"

struct Columns { /* a transform in the order in which it is sent: the three columns of the rotation, then the position */
    float numbers[12];
};

inline void send_transform(igtl::Socket *socket, const char *name, const Columns &c) {
    igtl::TransformMessage::Pointer m = igtl::TransformMessage::New();
    igtl::Matrix4x4 matrix = {};
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 4; column++) matrix[row][column] = c.numbers[3 * column + row];
    matrix[3][3] = 1;
    m->SetDeviceName(name);
    m->SetMatrix(matrix);
    m->Pack();
    socket->Send(m->GetPackPointer(), m->GetPackSize());
}

class Client {
public:
    explicit Client(int port) : socket(igtl::ClientSocket::New()) { EXPECT(socket->ConnectToServer("127.0.0.1", port) == 0, "port %d", port); }
    ~Client() { socket->CloseSocket(); }

    /* Receives one message. Returns false if the connection has ended. */
    bool receive() {
        igtl::MessageHeader::Pointer head = igtl::MessageHeader::New();
        head->InitPack();
        if (socket->Receive(head->GetPackPointer(), head->GetPackSize()) != head->GetPackSize()) return false;
        head->Unpack();
        std::string type = head->GetDeviceType(), name = head->GetDeviceName();
        unsigned sec = 0, fraction = 0;
        head->GetTimeStamp(&sec, &fraction);
        counts[name]++;
        ages[name].push_back(epoch_seconds() - sec - fraction / 4294967296.0);
        if (type == "TRANSFORM") return body(transforms[name], head);
        if (type == "STRING") return body(strings[name], head);
        if (type == "IMAGE") return body(images[name], head);
        if (type == "POLYDATA") return body(surfaces[name], head);
        EXPECT(false, "an unexpected %s", type.c_str());
        return false;
    }
    void receive_for(double s) {
        for (double end = seconds() + s; seconds() < end && receive();) continue;
    }
    /* Waits until the condition holds. Returns false after `patience` s. */
    template <typename Condition> bool until(Condition holds, double patience = 10) {
        for (double end = seconds() + patience; seconds() < end && receive();)
            if (holds()) return true;
        return false;
    }
    bool has(std::vector<std::string> names) {
        return until([&] {
            for (const std::string &name : names)
                if (counts[name] == 0) return false;
            return true;
        });
    }
    Columns transform(const std::string &name) {
        Columns c;
        igtl::Matrix4x4 m;
        transforms[name]->GetMatrix(m);
        for (int column = 0; column < 4; column++)
            for (int row = 0; row < 3; row++) c.numbers[3 * column + row] = m[row][column];
        return c;
    }
    std::string text(const std::string &name) { return counts[name] ? strings[name]->GetString() : ""; }

    igtl::ClientSocket::Pointer socket;
    std::map<std::string, int> counts;
    std::map<std::string, std::vector<double>> ages; /* s, ages of the messages on arrival, by their time stamps */
    std::map<std::string, igtl::TransformMessage::Pointer> transforms;
    std::map<std::string, igtl::StringMessage::Pointer> strings;
    std::map<std::string, igtl::ImageMessage::Pointer> images;
    std::map<std::string, igtl::PolyDataMessage::Pointer> surfaces;

private:
    template <typename Pointer> bool body(Pointer &kept, igtl::MessageHeader::Pointer &head) {
        Pointer m = Pointer::ObjectType::New();
        m->SetMessageHeader(head);
        m->AllocatePack();
        if (socket->Receive(m->GetPackBodyPointer(), m->GetPackBodySize()) != m->GetPackBodySize()) return false;
        int unpacked = m->Unpack(1); /* 1: also checks the checksum */
        EXPECT(unpacked & igtl::MessageHeader::UNPACK_BODY, "%s", head->GetDeviceName());
        kept = m;
        return true;
    }
};

/* Sends and receives bytes. */
class Connection {
public:
    explicit Connection(int port, int buffer = 0) : descriptor(::socket(AF_INET, SOCK_STREAM, 0)) {
        sockaddr_in address = {};
        address.sin_family = AF_INET;
        address.sin_port = htons(static_cast<uint16_t>(port));
        address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        timeval patience = {5, 0};
        setsockopt(descriptor, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
        if (buffer) setsockopt(descriptor, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof buffer);
        EXPECT(connect(descriptor, reinterpret_cast<sockaddr *>(&address), sizeof address) == 0, "port %d", port);
    }
    Connection(const Connection &) = delete;
    ~Connection() { close(descriptor); }
    void send(const std::vector<unsigned char> &bytes) { EXPECT(::send(descriptor, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size())); }
    bool receive(void *bytes, size_t size) { return recv(descriptor, bytes, size, MSG_WAITALL) == static_cast<ssize_t>(size); }
    bool is_closed() { /* whether the other side has closed the connection; discards received bytes */
        unsigned char bytes[65536];
        ssize_t count;
        for (double end = seconds() + 10; (count = recv(descriptor, bytes, sizeof bytes, 0)) > 0 && seconds() < end;) continue;
        return count == 0 || (count < 0 && errno == ECONNRESET);
    }

private:
    int descriptor;
};

#endif
